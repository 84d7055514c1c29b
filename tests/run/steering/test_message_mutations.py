"""Damaged messages and records, 500 of each: refused in one sentence, or what their JSON says."""

import json
import math
import random

import pytest
from mutations import mutated
from tipfem.render.viewer.protocol import ProtocolError, parse

from tipfem.run.steering.record import Record

MUTATIONS = 500
MESSAGES = [
    '{"type": "size", "width": 800, "height": 600, "ratio": 1.5}',
    '{"type": "show", "time": 0.25}',
    '{"type": "range", "mode": "given", "low": -1.0, "high": 2.5}',
    '{"type": "layers", "mesh": true, "tracers": 100, "contours": "pressure"}',
    '{"type": "window", "window": [0.0, 0.0, 1.0, 0.5]}',
    '{"type": "pick", "pane": 0, "at": [0.25, 0.75], "history": true}',
    '{"type": "command", "name": "gravity", "value": [1.5, -9.81]}',
    '{"type": "command", "name": "poke", "at": [0.1, 0.2], "acceleration": [3.0, 0.0], "radius": 0.05}',
    '{"type": "command", "name": "drop", "at": [0.1, 0.2], "radius": 0.05, "fluid": "water"}',
]
RECORDS = [
    '{"step": 12, "time": 0.25, "command": "gravity", "value": [1.5, -9.81]}',
    '{"step": 12, "time": 0.25, "command": "drop", "at": [0.1, 0.2], "radius": 0.05, "fluid": "water"}',
    '{"step": 3, "time": 0.01, "command": "poke", "at": [0.1, 0.2], "acceleration": [3.0, 0.0], "radius": 0.05}',
]


def numbers_in(value):
    """All numbers of a value."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [number for item in value for number in numbers_in(item)]
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else []


@pytest.mark.parametrize("number", range(0, MUTATIONS, 50))
def test_a_damaged_message_is_refused_or_means_what_it_says(number):
    refused = 0
    for seed in range(number, number + 50):
        rng = random.Random(seed)
        text = mutated(rng, rng.choice(MESSAGES))
        try:
            message, said = parse(text), ""
        except ProtocolError as error:
            said, refused = str(error), refused + 1
        assert len(said) < 300
        if said:
            continue
        assert all(map(math.isfinite, numbers_in(message)))
        assert sorted(numbers_in(message)) == sorted(numbers_in(json.loads(text)))
    assert 0 < refused < 50


@pytest.mark.parametrize("number", range(0, MUTATIONS, 50))
def test_a_damaged_record_is_refused_or_means_what_it_says(number):
    refused = 0
    for seed in range(number, number + 50):
        rng = random.Random(seed)
        text = mutated(rng, rng.choice(RECORDS))
        try:
            record, said = Record.parse(text), ""
        except ValueError as error:
            said, refused = str(error), refused + 1
        assert len(said) < 300
        if said:
            continue
        assert all(map(math.isfinite, numbers_in(record.command.values())))
        assert record.step == json.loads(text)["step"]
    assert 0 < refused < 50
