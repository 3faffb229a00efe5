"""The stand-in for the rig's own doser against its page: bytes and times in, bytes and motion out, without a driver."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.rig_doser.emulator.firmware import Firmware
from drivers.rig_doser.emulator.frames import Request, RequestReader, framed
from drivers.rig_doser.emulator.memory import Commissioning, Record, StateFile

PAGE = Path(__file__).parents[1] / "firmware_notes" / "rig_doser.md"


class RigDoser:
    """A board on the bench: memory, a shaft that can jam, its own clock; what really was pushed."""

    def __init__(self, path: Path, protocol: int) -> None:
        self.state, self.protocol = StateFile(path, Commissioning("TD000007", 50_000, 10_000_000)), protocol
        self.now_s, self.pushed, self._jams_at, self._asked = 0.0, 0, math.inf, 0
        self.reset()

    def reset(self) -> None:
        self.firmware = Firmware(self.state, 2000.0, 8000.0, self._pulse, self.protocol)
        self.reader = RequestReader(self.protocol)

    def board(self, **record: int) -> None:
        self.state.save(Record(**record))
        self.reset()
        self.firmware.record.boots = 0

    def _pulse(self) -> bool:
        if self.pushed >= self._jams_at:
            return False
        self.pushed += 1
        return True

    def jam(self, steps: int) -> None:
        self._jams_at = self.pushed + steps

    def wait(self, seconds: float) -> None:
        self.now_s += seconds
        self.firmware.advance(self.now_s)

    def send(self, text: str) -> str:
        """What a frame with a right CRC is answered by, without CRC; "nothing" where there is no reply."""
        replies = [
            self.firmware.answer(item, self.now_s).decode().partition("*")[0]
            for item in self.reader.feed(framed(text), self.now_s)
            if isinstance(item, Request)
        ]
        return " ".join(replies) or "nothing"

    def ask(self, text: str) -> str:
        self._asked = (self._asked + 1) % 256
        return self.send(f">{self._asked:02X}{text}")[3:]

    def play(self, line: str) -> None:
        """A line of an exchange that is no frame."""
        word, *arguments = line.split()
        if word == "board":
            self.board(**{key: int(value) for key, value in (argument.split("=") for argument in arguments)})
        elif word == "stop":
            for _ in range(int(arguments[0]) if arguments else 1):
                self.firmware.stop(self.now_s)
        elif word == "forget":
            self.state.forget()
            self.reset()
        elif word == "wait":
            self.wait(float(arguments[0]))
        elif word == "jam":
            self.jam(int(arguments[0]))
        else:
            assert word == "reset", line
            self.reset()


def exchanges() -> Iterator[Any]:
    """The page's exchanges, each for both versions."""
    blocks = PAGE.read_text().split("    exchange ")[1:]
    for i, block in enumerate(blocks):
        number, *lines = block.partition("\n\n")[0].splitlines()
        for protocol in (1, 2):
            yield pytest.param(protocol, [line.strip() for line in lines], id=f"{number}-{i}-{protocol:02d}")


@pytest.mark.parametrize(("protocol", "lines"), list(exchanges()))
def test_the_board_answers_as_on_its_page(tmp_path: Path, protocol: int, lines: list[str]) -> None:
    doser, reply, checked = RigDoser(tmp_path / "state", protocol), "", 0
    for line in lines:
        if line.startswith(">"):
            reply = doser.send(line)
        elif line.startswith(("both ", "01 ", "02 ")):
            version, expected = line.split()
            if version in ("both", f"{protocol:02d}"):
                assert reply == expected
                checked += 1
        else:
            doser.play(line)
    assert checked == sum(line.startswith(">") for line in lines)


def test_the_page_decides_all_eleven_questions() -> None:
    numbers = {int(block.split()[0]) for block in PAGE.read_text().split("    exchange ")[1:]}
    assert numbers == set(range(1, 12))


@pytest.mark.parametrize("protocol", [1, 2])
def test_banner_and_identity_name_the_version(tmp_path: Path, protocol: int) -> None:
    doser = RigDoser(tmp_path / "state", protocol)
    assert doser.firmware.banner().startswith(b"!TANKRIG-DOSER %02X TD000007 0001*" % protocol)
    assert doser.ask("I").startswith(f"I{protocol:02X}TD000007")


@pytest.mark.parametrize("protocol", [1, 2])
@pytest.mark.parametrize("length", [96, 97])
def test_a_frame_has_96_characters_without_its_line_feed(tmp_path: Path, protocol: int, length: int) -> None:
    doser = RigDoser(tmp_path / "state", protocol)
    assert doser.send(">01S" + "0" * (length - 9)) == ("<01E02" if length == 96 else "nothing")


def test_in_version_02_no_late_copy_of_a_clear_or_a_persons_word_undoes_what_came_later(tmp_path: Path) -> None:
    doser = RigDoser(tmp_path / "state", 2)
    doser.board(count=600, doubt=1, life=600, dose_id=5, target=900, flags=6, reason=4, stops=3)
    clear, word = "C0003", "Z000002570003"
    assert doser.ask(word).startswith("S02")
    assert doser.ask(clear).startswith("S00")
    doser.ask("D0000000600002000")
    doser.wait(3.0)
    stopped = doser.ask("S")
    assert stopped.startswith("S0203"), "the watchdog stopped it"
    assert doser.ask(clear) == doser.ask(word) == "E0B"
    assert doser.ask("S") == stopped


RECORDS = st.fixed_dictionaries({"life": st.integers(0, 10_000_000), "stops": st.integers(0, 0xFFFF)})
ORDERS = st.sampled_from(["D", "D", "D again", "C", "C old", "Z", "Z old", "S", "I", "stop", "wait", "reset", "jam"])


@pytest.mark.parametrize("protocol", [1, 2])
@settings(deadline=None)
@given(orders=st.lists(st.tuples(ORDERS, st.integers(0, 3000)), max_size=30), record=RECORDS)
def test_the_plunger_is_always_between_count_less_doubt_and_count(
    tmp_path_factory: pytest.TempPathFactory, protocol: int, orders: list[tuple[str, int]], record: dict[str, int]
) -> None:
    doser = RigDoser(tmp_path_factory.mktemp("doser") / "state", protocol)
    doser.board(**record)
    state, copies, next_id, intended = doser.firmware.record, dict[str, str](), 1, 0
    for order, number in orders:
        record_now = doser.firmware.record
        if order == "D":
            target = record_now.count + number
            copies["D"] = f"D{next_id:08X}{target:08X}"
            next_id += 1
        if order in ("D", "D again") and "D" in copies:  # a copy of a refused one may be accepted later
            if doser.ask(copies["D"]).startswith("S"):
                intended = max(intended, int(copies["D"][9:], 16))
        elif order == "C":
            copies["C"] = f"C{record_now.stops:04X}"
            doser.ask(copies["C"])
        elif order == "Z" and not doser.firmware.moving:
            suffix = f"{record_now.stops:04X}" if protocol == 2 else ""
            copies["Z"] = f"Z{doser.pushed:08X}{suffix}"
            doser.ask(copies["Z"])
        elif order in ("C old", "Z old") and order[0] in copies and protocol == 2:
            doser.ask(copies[order[0]])
        elif order in ("S", "I"):
            doser.ask(order)
        elif order in ("stop", "reset"):
            doser.play(order)
        elif order == "wait":
            doser.wait(number / 1000)
        elif order == "jam":
            doser.jam(number)
        state = doser.firmware.record
        assert state.count - state.doubt <= doser.pushed <= state.count
        assert doser.pushed <= intended
    doser.state.close()
