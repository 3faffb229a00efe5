"""Protocol pages, drivers and stand-ins of the pumps say the same bytes; the pages' own vectors tie them together."""

import random
import re
from pathlib import Path

import pytest

from drivers import serial_line
from drivers.cavro import pump as cavro_pump
from drivers.cavro import wire as cavro
from drivers.cavro.emulator import core as cavro_core
from drivers.cavro.emulator import frames as cavro_frames
from drivers.dosing import doser
from drivers.new_era import wire as new_era
from drivers.new_era.emulator import board as new_era_board
from drivers.new_era.emulator import frames as new_era_frames

NOTES = Path(__file__).parents[1] / "firmware_notes"
ROW = re.compile(r"^\| `((?:[0-9A-F]{2} ?)+)` \| (?:`(.+)`)? ?\| (\w+): (.*) \|$", re.MULTILINE)
NEW_ERA, CAVRO = ((NOTES / f"{name}.md").read_text(encoding="utf-8") for name in ("new_era", "cavro"))


def vectors(page: str, kind: str) -> list[tuple[bytes, str, str]]:
    return [(bytes.fromhex(digits), text, rest) for digits, text, what, rest in ROW.findall(page) if what == kind]


def test_the_pages_have_the_vectors_that_were_handed_down() -> None:
    assert [len(vectors(page, kind)) for page in (NEW_ERA, CAVRO) for kind in ("command", "reply", "answer")] == [
        2, 2, 0, 3, 0, 1,
    ]  # fmt: skip


@pytest.mark.parametrize(("data", "text", "_"), vectors(NEW_ERA, "command") + vectors(NEW_ERA, "reply"))
def test_new_era_packets_are_those_of_the_page_on_both_sides(data: bytes, text: str, _: str) -> None:
    assert new_era.packet(text) == new_era_frames.safe(text) == data
    assert list(new_era.packets(bytearray(data))) == [text.encode()]
    assert new_era_frames.Reader().feed(data, 0.0, safe_mode=True) == text


def test_new_era_replies_are_understood() -> None:
    (_, stopped, _), (_, alarm, _) = vectors(NEW_ERA, "reply")
    assert new_era.reply(stopped.encode()) == new_era.Reply(0, "S", "")
    assert new_era.reply(alarm.encode()) == new_era.Reply(0, "A", "", "R")
    assert new_era.reply(b"00S?OOR").error == "a value is out of its range"
    assert new_era.reply(b"00Z") is None


@pytest.mark.parametrize(("data", "text", "fields"), vectors(CAVRO, "command"))
def test_cavro_commands_are_those_of_the_page_on_both_sides(data: bytes, text: str, fields: str) -> None:
    sequence, repeated = (int(field[-1]) for field in fields.split())
    assert cavro.command(1, sequence, text, repeat=bool(repeated)) == data
    assert cavro_frames.Reader().feed(data) == [cavro_frames.Command(1, sequence, bool(repeated), text)]


def test_the_cavro_answer_is_that_of_the_page_on_both_sides() -> None:
    ((data, _, _),) = vectors(CAVRO, "answer")
    assert cavro_frames.answered(0x60, "") == data
    assert [cavro.reply(text) for text in cavro.replies(bytearray(data))] == [cavro.Reply(True, 0, "")]


def damaged(data: bytes) -> list[bytes]:
    """Every single flipped bit and every single lost byte."""
    flipped = [data[:i] + bytes([data[i] ^ 1 << bit]) + data[i + 1 :] for i in range(len(data)) for bit in range(8)]
    return flipped + [data[:i] + data[i + 1 :] for i in range(len(data))]


def test_a_damaged_packet_is_never_taken_for_another() -> None:
    for data, _, _ in vectors(NEW_ERA, "command") + vectors(NEW_ERA, "reply"):
        for frame in damaged(data):
            assert not list(new_era.packets(bytearray(frame)))
            assert new_era_frames.Reader().feed(frame, 0.0, safe_mode=True) is None
    for data, _, _ in vectors(CAVRO, "command"):
        for frame in damaged(data):
            assert not cavro_frames.Reader().feed(frame)
    for frame in damaged(vectors(CAVRO, "answer")[0][0]):
        assert not list(cavro.replies(bytearray(frame)))


def test_a_reply_is_found_behind_any_noise_and_in_any_pieces() -> None:
    """03 and 02 inside a packet do not end or begin it."""
    noise = random.Random(3)
    for reply in ("00SI0.000W0.000UL", "00S" + "\x02\x03" * 3):
        received = bytearray(noise.randbytes(3).replace(b"\x02", b"\x00"))
        data = new_era.packet(reply)
        cut = noise.randrange(1, len(data))
        received += data[:cut]
        assert not list(new_era.packets(received))
        received += data[cut:]
        assert list(new_era.packets(received)) == [reply.encode()]
    received = bytearray(b"\xff\x00\x03" + cavro_frames.answered(0x40, "1500"))
    assert [cavro.reply(text) for text in cavro.replies(received)] == [cavro.Reply(False, 0, "1500")]


@pytest.mark.parametrize(
    ("thousandths", "text"),
    [(1, "0.001"), (9999, "9.999"), (10_000, "10.00"), (99_990, "99.99"), (999_900, "999.9"), (1_000_000, "1000")],
)
def test_numbers_keep_to_four_digits_without_exponent(thousandths: int, text: str) -> None:
    """Other drivers cut such numbers off as strings, or send 1e+03."""
    assert new_era.number(thousandths) == text


def test_codes_and_times_are_those_of_the_pages() -> None:
    alarms = dict(re.findall(r"`A\?([A-Z])` \| ([^|]+) \|", NEW_ERA))
    assert set(alarms) == set(new_era.ALARMS)
    table = CAVRO.split("| error | meaning | error | meaning |")[1].split("\n\n")[0]
    errors = {int(code) for code in re.findall(r"\| (\d+) \|", table)}
    assert errors == set(cavro.ERRORS)
    host = {
        "timeout": serial_line.REPLY_S,
        "quiet": serial_line.QUIET_S,
        "patience": serial_line.PATIENCE_S,
        "poll": doser.POLL_S,
    }
    device = {"gap": new_era_frames.GAP_S, "boot": new_era_board.BOOT_S}
    assert host | device == times(NEW_ERA)
    assert host | {"piece": cavro_pump.PIECE_S, "valve": cavro_core.VALVE_S} == times(CAVRO)


def times(page: str) -> dict[str, float]:
    return {name: float(ms) / 1e3 for name, ms in re.findall(r"^\| (\w+) \| (\d+) ms \|", page, re.MULTILINE)}
