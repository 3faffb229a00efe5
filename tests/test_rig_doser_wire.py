"""Protocol page, driver and emulator say the same bytes; the page's own test vectors tie them together."""

import binascii
import random
import re
from dataclasses import asdict
from pathlib import Path

import pytest

from drivers.dosing import doser
from drivers.rig_doser import line, wire
from drivers.rig_doser.emulator import board, firmware, frames, memory
from drivers.rig_doser.emulator.memory import Commissioning, Record, StateFile

PAGE = (Path(__file__).parents[1] / "firmware_notes" / "rig_doser.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| `((?:[0-9A-F]{2} ?)+)` \| (?:`(.+)`)? ?\| (\w+) ?(.*) \|$", re.MULTILINE)
ARGUMENTS = {"dose": ("D", {"id": 8, "target": 8}), "clear": ("C", {"stops": 4}), "resolve": ("Z", {"count": 8})}
ARGUMENTS |= {"identify": ("I", {}), "status": ("S", {})}


def vectors() -> list[tuple[bytes, str, dict[str, str]]]:
    rows = []
    for digits, text, kind, fields in ROW.findall(PAGE):
        data = bytes.fromhex(digits)
        assert kind == "stop" or data == text.encode()
        rows.append((data, kind, dict(field.split("=") for field in fields.split())))
    return rows


VECTORS = vectors()
REQUESTS = [row for row in VECTORS if row[1] in ARGUMENTS]


def numbers(fields: dict[str, str]) -> dict[str, object]:
    """Fields as numbers, but for texts and the sequence number."""
    return {key: int(value) if value.isdigit() else value for key, value in fields.items() if key != "ss"}


def test_the_page_has_a_vector_of_every_kind() -> None:
    kinds = {kind for _, kind, _ in VECTORS}
    assert kinds == set(ARGUMENTS) | {"banner", "identity", "state", "error", "stop"}


@pytest.mark.parametrize(("data", "kind", "fields"), REQUESTS)
def test_driver_sends_the_requests_of_the_page(data: bytes, kind: str, fields: dict[str, str]) -> None:
    command, widths = ARGUMENTS[kind]
    arguments = [(int(fields[name]), width) for name, width in widths.items()]
    assert wire.request(int(fields["ss"], 16), command, *arguments) == data + b"\n"


@pytest.mark.parametrize(("data", "kind", "fields"), REQUESTS)
def test_emulator_reads_the_requests_of_the_page(data: bytes, kind: str, fields: dict[str, str]) -> None:
    (request,) = frames.RequestReader().feed(data + b"\n", 0.0)
    command, widths = ARGUMENTS[kind]
    digits = "".join(f"{int(fields[name]):0{width}X}" for name, width in widths.items())
    assert request == frames.Request(fields["ss"], command, digits)


@pytest.mark.parametrize(("data", "kind", "fields"), [row for row in VECTORS if row not in REQUESTS])
def test_driver_reads_the_replies_of_the_page(data: bytes, kind: str, fields: dict[str, str]) -> None:
    if kind == "stop":
        assert set(wire.STOP) == set(data)
    elif kind == "banner":
        assert asdict(wire.banner(data)) == numbers(fields)
    else:
        sequence, reply = wire.reply(data)
        assert sequence == int(fields["ss"], 16)
        known = {"code": reply.code} if kind == "error" else asdict(reply)
        assert known == numbers(fields)


@pytest.mark.parametrize(("data", "kind", "fields"), [row for row in VECTORS if row not in REQUESTS])
def test_emulator_sends_the_replies_of_the_page(data: bytes, kind: str, fields: dict[str, str], tmp_path: Path) -> None:
    if kind == "stop":
        (item,) = frames.RequestReader().feed(data, 0.0)
        assert isinstance(item, frames.StopByte)
        return
    new = Commissioning(*(numbers(fields).get(name, default) for name, default in asdict(Commissioning()).items()))
    state = StateFile(tmp_path / "state", new)
    state.save(Record(boots=int(fields.get("boots", 1)) - 1))
    board_side = firmware.Firmware(state, rate=2000.0, acceleration=8000.0, pulse=lambda: True)
    if kind == "state":
        record = {name.replace("dose_id", "id"): name for name in asdict(Record())}
        board_side.record = Record(**{record[k]: v for k, v in numbers(fields).items()})
    if kind == "banner":
        assert board_side.banner() == data + b"\n"
    else:
        ask = {"identity": ("I", ""), "state": ("S", ""), "error": ("C", "FFFF")}[kind]
        assert board_side.answer(frames.Request(fields["ss"], *ask), 0.0) == data + b"\n"
    state.close()


def exchanges() -> list[tuple[str, str]]:
    """What the page's exchanges have a host send and a board reply: (version, frame without CRC)."""
    part = PAGE.split("Exchanges with a board")[1].split("\n## ")[0]
    sent = [("both", text) for text in re.findall(r"^    (>\S+)$", part, re.MULTILINE)]
    return sent + re.findall(r"^    (both|01|02) (<\S+)$", part, re.MULTILINE)


BY_VERSION = {"D": (8, 8), "C": (4,), "Z": (8, 4), "I": (), "S": ()}
"""Digits of the arguments; those of `Z` in 02."""


def test_driver_says_what_the_exchanges_of_the_page_say() -> None:
    """Whatever a well-formed request of either version is on the page, the driver writes the same bytes."""
    written = 0
    for _, text in exchanges():
        sequence, command, digits = text[1:3], text[3], text[4:]
        if text[0] == "<" or command not in BY_VERSION or not re.fullmatch(r"[0-9A-F]*", sequence + digits):
            continue
        widths = BY_VERSION[command] if command != "Z" or len(digits) == 12 else (8,)
        if len(digits) != sum(widths):
            continue
        parts = [digits[sum(widths[:i]) : sum(widths[: i + 1])] for i in range(len(widths))]
        arguments = [(int(part, 16), len(part)) for part in parts]
        assert wire.request(int(sequence, 16), command, *arguments).startswith(f"{text}*".encode())
        written += 1
    assert written >= 30


def test_driver_reads_what_boards_of_both_versions_reply_on_the_page() -> None:
    read = {"01": 0, "02": 0}
    for version, text in exchanges():
        if text[0] == "<" and text[1:3].isupper() | text[1:3].isdigit():
            sequence, reply = wire.reply(f"{text}*{binascii.crc_hqx(text.encode(), 0xFFFF):04X}".encode())
            assert sequence == int(text[1:3], 16)
            if isinstance(reply, wire.Refusal):
                assert reply.code in wire.REFUSALS
            if isinstance(reply, wire.Identity):
                assert version == f"{reply.protocol:02d}"
            for one in read:
                read[one] += version in (one, "both")
    assert min(read.values()) >= 25


def test_a_damaged_frame_is_never_taken_for_another() -> None:
    """Every single flipped bit, and every single lost byte, in every vector."""
    for data, kind, _ in VECTORS:
        if kind == "stop":
            continue
        damaged = [data[:i] + bytes([data[i] ^ 1 << bit]) + data[i + 1 :] for i in range(len(data)) for bit in range(8)]
        damaged += [data[:i] + data[i + 1 :] for i in range(len(data))]
        for frame in damaged:
            assert wire.reply(frame) is None
            assert wire.banner(frame) is None
            items = list(frames.RequestReader().feed(frame + b"\n", 0.0))
            assert not any(isinstance(item, frames.Request) for item in items)


def test_the_emulator_finds_a_request_in_any_noise_and_a_stop_byte_inside_it() -> None:
    noise = random.Random(1)
    for data, _, fields in REQUESTS:
        junk = bytes(b for b in noise.randbytes(80) if b != frames.STOP)
        cut = noise.randrange(1, len(data))
        items = list(frames.RequestReader().feed(junk + data[:cut] + b"\x18" + data[cut:] + b"\n", 0.0))
        assert isinstance(items[0], frames.StopByte)
        assert items[1].sequence == fields["ss"]


def test_a_frame_that_pauses_too_long_is_dropped() -> None:
    reader, data = frames.RequestReader(), REQUESTS[0][0] + b"\n"
    assert not list(reader.feed(data[:4], 0.0))
    assert not list(reader.feed(data[4:], frames.GAP_S + 0.001))
    assert list(reader.feed(data, 0.2))


def test_codes_and_times_are_those_of_the_page() -> None:
    def table(head: str) -> dict[str, int]:
        rows = PAGE.split(f"| {head} | name |")[1].split("\n\n")[0]
        return {
            name: int(code, 16) for code, name in re.findall(r"^\| ([0-9A-F]{2}) \| ([A-Z_]+) \|", rows, re.MULTILINE)
        }

    assert table("flag") == {flag.name: flag.value for flag in wire.Flag}
    assert table("reason") == {reason.name: reason.value for reason in wire.Reason}
    assert table("reason") == {name: getattr(memory, name) for name in table("reason")}
    in_02 = {int(code, 16) for code in re.findall(r"Version 02 has one code more, `([0-9A-F]{2})`", PAGE)}
    assert set(table("code").values()) | in_02 == set(wire.REFUSALS)
    assert table("code") == {name: getattr(firmware, f"E_{name}") for name in table("code")}
    times = {name: float(ms) / 1e3 for name, ms in re.findall(r"^\| (\w+) \| (\d+) ms \|", PAGE, re.MULTILINE)}
    driver = {"banner": line.BANNER_S, "timeout": line.REPLY_S, "poll": doser.POLL_S}
    emulator = {"boot": board.BOOT_S, "watchdog": firmware.WATCHDOG_S, "gap": frames.GAP_S}
    assert driver | emulator == {name: times[name] for name in driver | emulator}
