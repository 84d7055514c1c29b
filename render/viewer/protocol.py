"""The messages between a viewer and its pages, version 2.

A page sends JSON text. The viewer sends JSON text, and frames and files as binary messages: a length L as an unsigned
32-bit integer, little-endian; L bytes of JSON; then the images or the file. Everything is in SI units and in the
coordinates of the domain, whatever the zoom.

**From the page.** Anything else, numbers that are not finite, and text over `LARGEST` bytes are refused. Only the
first page steers; of the others' messages, those marked * are answered, and the rest are ignored.

| message | meaning |
|---|---|
| `{"type": "ack", "frame": 7}` * | the frame is on the screen; at most `AHEAD` frames are sent before it |
| `{"type": "visible", "on": false}` * | no frames are wanted: the page is hidden |
| `{"type": "size", "width": 900, "height": 600}` | of a picture [CSS px], by which layers are spaced |
| `{"type": "theme", "dark": true}` | colours around the fluids, for pictures and movies that are kept |
| `{"type": "play", "on": true}` | go through the stored times, or stop |
| `{"type": "speed", "value": 0.05}` | simulated seconds per second |
| `{"type": "show", "time": 0.12}` | the stored time nearest to this one [s] |
| `{"type": "step", "count": -1}` | so many stored times on, or back |
| `{"type": "field", "name": "pressure"}` | colour by a field; null for the fluids |
| `{"type": "range", "mode": "given", "low": 0, "high": 3e3}` | of the colours: "fixed" for all times, "frame" for \
each, "given" |
| `{"type": "map", "name": "viridis"}` | of the colours; null for the usual one of the field |
| `{"type": "layers", "mesh": true, "contours": "pressure"}` | any of `LAYERS` |
| `{"type": "window", "window": [0, 0, 0.3, 0.2]}` | the part shown [m]; null for all. It is widened to the picture's \
shape |
| `{"type": "follow", "what": "front"}` | move the window with a front or a fluid, as `View.follow`; null to stop |
| `{"type": "camera", "azimuth": -25, "elevation": 18}` | of a flow in 3-D, for pictures and movies that are kept |
| `{"type": "pick", "pane": 0, "at": [0.1, 0.2], "history": false}` * | ask for the values at a point |
| `{"type": "picture"}` * | ask for the present picture with its axes, as a PNG file |
| `{"type": "share"}` * | ask for the page that `tipfem share` makes, of results, or of what has been seen of a run |
| `{"type": "alive"}` | asks for an answer, by which the page knows that the connection carries messages |
| `{"type": "record", "on": true}` | begin a movie of what is seen, or end it and ask for the file |
| `{"type": "command", "name": "poke", ...}` | a command to the simulation, see below |

**Commands** are passed to `Source.command` if the source has their name among its `commands`.

| name | values |
|---|---|
| `pause`, `go`, `stop`, `again` | none. Pause after the present step; go on; end the run as an interrupt does; and \
begin it anew |
| `undo` | none. Go back to before the last command that changed the physics |
| `step` | `count`: so many steps, then pause |
| `gravity` | `value`: (2,) [m/s^2] |
| `poke` | `at`: (2,) [m], `acceleration`: (2,) [m/s^2], `radius`: [m]. It acts until the next one; `at`: null ends \
it, which the viewer also sends when the page that pokes goes away |
| `drop` | `at`: (2,) centre [m], `radius`: [m], `fluid`: its name |
| `viscosity` | `fluid`: its name, `value`: [Pa s] |
| `tension` | `between`: names of two fluids, or of one at a free surface, `value`: [N/m] |
| `wall` | `wall`: its name, `value`: its displacement [m], or speed along itself [m/s] |
| `valve` | `opening`: its name, `open`: true or false |
| `discharge` | `opening`: name of an inlet, `value`: [m^2/s] |

**To the page.**

| message | content |
|---|---|
| `hello` | `version`; `steers`: whether this page steers; `panes`: of each source its `name`, `title`, `fluids` \
(`name`; `light` and `dark`: its colours at the top, at the bottom and on the average), \
`lower`, `upper`, `spacing`, `solids`: thin \
ones, see page/outlines.js; `solid`: null, or of a flow in 3-D what page/solid.js needs; \
`fields`: `name`, `label`, `unit`, whether it is `positive`; \
`maps`: lists of colours by name; \
`commands`; `limits`; `tool`: what the pointer does at first, "look" or "poke"; `openings`: `name` and `kind` of those \
that commands take; `viscosities` of the fluids at the start, where they can be changed [Pa s]; `tensions`: `between` \
and `value` at the start; `walls`: `name`, \
`value` at the start and whether it `slides`, of those that commands move; `floating`: numbers of the bodies that \
float, among the loops of bodies |
| `role` | `steers`: sent when this page becomes the one that steers |
| `status` | all that the controls show: `times` (first, last, count, interval), `playing`, `speed`, `field`, `range`, \
`map`, `layers`, `window`, `follow`, `camera`, `recording`, `size`, `live`, and `runs`: of each source what \
`Source.status` returns |
| a frame | JSON: `type` "frame", `frame`: its number, `field`, `low`, `high`, `map`, \
`moves`: whether time goes on, and `panes`: `time`, `index`, \
`bytes`, `notes`: lines on the scales of layers, `muted`: names of the fluids that have their own colour, `lower`, \
`scale`, `behind`: the fluid behind all others or null, `smooth`, `openings`, `still`: whether the tank is where it \
was at first, and `turns`: lines that show what turns; then the outlines of each pane, which page/outlines.js reads. \
Where more than fluids is seen, there are `fade`: the share of the ground in the colours of the fluids; \
`cells`: of the triangles that stand before \
the outlines, see page/cells.js; `lines`: of the layers between them, see page/lines.js; and `window`: the part that \
follows the flow. Of a flow in 3-D panes have `time`, `index`, `bytes`, `counts` and `edges`, see page/solid.js |
| `picked` | `pane`, `at`, `time`, `inside`, `fluid`, `values` at the point, `particle` (`index`, `position`, `wall`, \
`values`), the nearest one |
| `history` | `pane`, `at`, `times`, `values`: lists by field at the point, null outside the fluids; `done`, the share |
| `series` | `plots`: what the run has recorded over time, each with `name`, `times`, `values`; again as there is more |
| a file | JSON: `type` "file", `name`, `mime`; then its bytes |
| `alive` | an answer to `alive` |
| `error` | `text`: one line |
| `bye` | `text`: why the viewer ends |
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from tipfem.arguments import brief, is_number

VERSION = 2
LARGEST = 16_384  # bytes of a message from a page
AHEAD = 2  # frames sent before the first of them is acknowledged
WATCHERS = frozenset({"ack", "alive", "visible", "pick", "picture", "share"})  # what is answered for every page
SIZES = (64, 4096)  # [px], sides of a picture
IN_PLANE = frozenset({"field", "range", "map", "layers", "window", "follow", "pick"})  # what flows in 3-D do not take
LAYERS = ("mesh", "particles", "fill", "arrows", "streamlines", "contours", "tracers", "colour_all", "smooth")
# What commands act on, by its key in the message `hello`.
STEERED = {
    "openings": "valve",
    "viscosities": "viscosity",
    "tensions": "tension",
    "walls": "wall",
    "floating": "drag",
}
_FARTHEST = 1e9  # largest magnitude of a number [SI]


class ProtocolError(ValueError):
    """A message that is not of the protocol; its text says why."""


Check = Callable[[str, Any], Any]


def _number(low: float = -_FARTHEST, high: float = _FARTHEST) -> Check:
    def check(name: str, value: Any) -> float:
        if not is_number(value):
            raise ProtocolError(f"{name}: expected a number, got {brief(value)}")
        if not low <= value <= high:
            raise ProtocolError(f"{name}: {value:g}, expected {low:g} to {high:g}")
        return float(value)

    return check


def _whole(low: int, high: int) -> Check:
    def check(name: str, value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ProtocolError(f"{name}: expected a whole number from {low} to {high}, got {brief(value)}")
        return value

    return check


def _flag(name: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise ProtocolError(f"{name}: expected true or false, got {brief(value)}")
    return value


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= 200:
        raise ProtocolError(f"{name}: expected text of 1 to 200 characters, got {brief(value)}")
    return value


def _names(name: str, value: Any) -> list[str]:
    if not isinstance(value, list) or len(value) not in (1, 2):
        raise ProtocolError(f"{name}: expected one or two names, got {brief(value)}")
    return [_text(name, each) for each in value]


def _choice(*words: str) -> Check:
    def check(name: str, value: Any) -> str:
        if value not in words:
            raise ProtocolError(f"{name}: expected one of {', '.join(words)}, got {brief(value)}")
        return str(value)

    return check


def _numbers(count: int) -> Check:
    number = _number()

    def check(name: str, value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or len(value) != count:
            raise ProtocolError(f"{name}: expected {count} numbers, got {brief(value)}")
        return tuple(number(name, each) for each in value)

    return check


def _window(name: str, value: Any) -> tuple[float, ...]:
    x0, y0, x1, y1 = _numbers(4)(name, value)
    if not (x1 - x0 > 1e-12 and y1 - y0 > 1e-12):
        raise ProtocolError(f"{name}: expected x0 below x1 and y0 below y1, got {brief(value)}")
    return x0, y0, x1, y1


def _or_null(check: Check) -> Check:
    return lambda name, value: None if value is None else check(name, value)


_POINT, _LENGTH = _numbers(2), _number(1e-12)
# What each message must have; a key that ends in "?" may be left out.
_MESSAGES: dict[str, dict[str, Check]] = {
    "ack": {"frame": _whole(0, 2**53)},
    "alive": {},
    "visible": {"on": _flag},
    "size": {"width": _whole(*SIZES), "height": _whole(*SIZES)},
    "theme": {"dark": _flag},
    "play": {"on": _flag},
    "speed": {"value": _number(1e-9, 1e6)},
    "show": {"time": _number()},
    "step": {"count": _whole(-1_000_000, 1_000_000)},
    "field": {"name": _or_null(_text)},
    "range": {"mode": _choice("fixed", "frame", "given"), "low?": _number(), "high?": _number()},
    "map": {"name": _or_null(_text)},
    "layers": {
        **{f"{name}?": _flag for name in LAYERS if name not in ("contours", "tracers")},
        "contours?": _or_null(_text),
        "tracers?": _whole(0, 2000),
    },
    "window": {"window": _or_null(_window)},
    "follow": {"what": _or_null(_text)},
    "camera": {"azimuth": _number(), "elevation": _number(-90, 90)},
    "pick": {"pane": _whole(0, 1), "at": _POINT, "history?": _flag},
    "picture": {},
    "share": {},
    "record": {"on": _flag},
}
_COMMANDS: dict[str, dict[str, Check]] = {
    "pause": {},
    "go": {},
    "stop": {},
    "again": {},
    "undo": {},
    "step": {"count?": _whole(1, 1_000_000)},
    "gravity": {"value": _POINT},
    "poke": {"at": _or_null(_POINT), "acceleration?": _POINT, "radius?": _LENGTH},
    "drop": {"at": _POINT, "radius": _LENGTH, "fluid": _text},
    "viscosity": {"fluid": _text, "value": _number(0, 1e6)},
    "tension": {"between": _names, "value": _number(0, 1e6)},
    "wall": {"wall": _text, "value": _number(-1e6, 1e6)},
    "valve": {"opening": _text, "open": _flag},
    "discharge": {"opening": _text, "value": _number(-1e6, 1e6)},
}
COMMANDS = tuple(_COMMANDS)


def parse(text: str | bytes) -> dict[str, Any]:
    """A message of a page, checked; points are tuples. `ProtocolError` if it is none of the protocol."""
    if not isinstance(text, str):
        raise ProtocolError("expected text, got a binary message")
    if len(text) > LARGEST:
        raise ProtocolError(f"a message of {len(text)} characters, expected at most {LARGEST}")
    try:
        given = json.loads(text)
    except (ValueError, RecursionError):
        raise ProtocolError(f"not JSON: {brief(text)}") from None
    if not isinstance(given, dict) or not isinstance(given.get("type"), str):
        raise ProtocolError(f"expected an object with a type, got {brief(given)}")
    kind = given.pop("type")
    if kind == "command":
        name = given.pop("name", None)
        if not isinstance(name, str) or name not in _COMMANDS:
            raise ProtocolError(f"command: expected one of {', '.join(_COMMANDS)}, got {brief(name)}")
        values = _checked(f"command {name}", given, _COMMANDS[name])
        if name == "poke" and values["at"] is not None and not {"acceleration", "radius"} <= values.keys():
            raise ProtocolError("command poke: expected at, acceleration and radius")
        return {"type": kind, "name": name, "values": values}
    if kind not in _MESSAGES:
        raise ProtocolError(f"type: expected one of {', '.join(_MESSAGES)} or command, got {brief(kind)}")
    message = _checked(kind, given, _MESSAGES[kind])
    if kind == "range" and message["mode"] == "given":
        if not {"low", "high"} <= message.keys() or not message["low"] < message["high"]:
            raise ProtocolError("range: expected low and high, low below high")
    return {"type": kind, **message}


def pack(head: Mapping[str, Any], parts: Sequence[bytes]) -> bytes:
    """A binary message with a head of JSON, and images, or a file."""
    text = to_json(head).encode()
    return b"".join([struct.pack("<I", len(text)), text, *parts])


def unpack(message: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON of a binary message made by `pack`, and what follows it."""
    (length,) = struct.unpack_from("<I", message)
    head = json.loads(message[4 : 4 + length])
    assert isinstance(head, dict), "pack wrote an object"
    return head, message[4 + length :]


def to_json(message: Mapping[str, Any]) -> str:
    """A message as text; numbers that are not finite are refused, for pages cannot read them."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


def _checked(where: str, given: dict[str, Any], wanted: dict[str, Check]) -> dict[str, Any]:
    names = {name.rstrip("?"): (name, check) for name, check in wanted.items()}
    for name in given:
        if name not in names:
            raise ProtocolError(f"{where}: {brief(name)} is not among {', '.join(names) or 'its values, it has none'}")
    found = {}
    for name, (key, check) in names.items():
        if name in given:
            found[name] = check(f"{where}: {name}", given[name])
        elif not key.endswith("?"):
            raise ProtocolError(f"{where}: {name} is missing")
    return found
