"""Damage to texts, chosen at random: values that fit nothing, words exchanged, letters, lines and ends lost."""

import re

NUMBER = re.compile(r"(?<![\w\".])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w\"])")
WORD = re.compile(r"[a-z_]{3,}")
VALUES = [
    "0",
    "-1",
    "1e-300",
    "1e300",
    "nan",
    "-inf",
    "true",
    '""',
    "[]",
    "{}",
    "[[1, 2], [3]]",
    "9" * 400,
    "1.5",
    "0x10",
]
CHARACTERS = "[]{}=\"'.,#\n\\ 0aé\t\0"


def number_replaced(rng, text):
    found = list(NUMBER.finditer(text))
    if not found:
        return text
    found = rng.choice(found)
    return text[: found.start()] + rng.choice(VALUES) + text[found.end() :]


def word_exchanged(rng, text):
    words = list(WORD.finditer(text))
    if len(words) < 2:
        return text
    one, other = rng.sample(words, 2)
    return text[: one.start()] + other[0] + text[one.end() :]


def letter_lost(rng, text):
    at = rng.randrange(len(text))
    return text[:at] + text[at + 1 :]


def character_added(rng, text):
    at = rng.randrange(len(text))
    return text[:at] + rng.choice(CHARACTERS) + text[at:]


def line_lost(rng, text):
    lines = text.splitlines(keepends=True)
    del lines[rng.randrange(len(lines))]
    return "".join(lines)


def line_moved(rng, text):
    lines = text.splitlines(keepends=True)
    line = lines.pop(rng.randrange(len(lines)))
    lines.insert(rng.randrange(len(lines) + 1), line)
    return "".join(lines)


def line_doubled(rng, text):
    lines = text.splitlines(keepends=True)
    lines.insert(rng.randrange(len(lines)), rng.choice(lines))
    return "".join(lines)


def end_cut_off(rng, text):
    return text[: rng.randrange(len(text))]


HOW = [  # more often what reaches farther
    *(number_replaced, number_replaced, word_exchanged, letter_lost, character_added),
    *(line_lost, line_moved, line_doubled, end_cut_off),
]


def mutated(rng, text):
    """The text with one or two such changes."""
    for _ in range(rng.choice([1, 1, 2])):
        text = rng.choice(HOW)(rng, text) if text else text
    return text
