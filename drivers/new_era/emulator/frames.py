"""The pump's side of its wire: Basic and Safe mode, written from the manual and firmware_notes/new_era.md."""

GAP_S = 0.5
DAMAGED = "\x15"


def _crc_of_byte(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


_OF_BYTE = [_crc_of_byte(byte) for byte in range(256)]


def crc(data: bytes) -> int:
    """CRC-CCITT with polynomial 0x1021 and start 0.

    >>> hex(crc(b"SAF0"))
    '0x5543'
    """
    value = 0
    for byte in data:
        value = (value << 8 & 0xFFFF) ^ _OF_BYTE[value >> 8 ^ byte]
    return value


def safe(text: str) -> bytes:
    """A Safe-mode packet.

    >>> safe("00S").hex(" ")
    '02 07 30 30 53 aa a6 03'
    """
    data = text.encode("ascii")
    return b"\x02%c%s%s\x03" % (len(data) + 4, data, crc(data).to_bytes(2, "big"))


def basic(text: str) -> bytes:
    """A reply in Basic mode."""
    return b"\x02%s\x03" % text.encode("ascii")


class Reader:
    """Finds commands in what comes in.

    Parameters
    ----------
    tells_damage
        Whether a packet of the right length with a wrong CRC counts, as `DAMAGED`; else it is dropped.
    """

    def __init__(self, tells_damage: bool = False) -> None:
        self._buffer = bytearray()
        self._last_s = 0.0
        self._tells_damage = tells_damage

    def feed(self, data: bytes, now_s: float, safe_mode: bool) -> str | None:
        """Take `data` in, then one command out; call again with nothing until None."""
        if data and safe_mode and now_s - self._last_s > GAP_S:
            self._buffer.clear()
        if data:
            self._last_s = now_s
        self._buffer += data
        return self._packet() if safe_mode else self._line()

    def _line(self) -> str | None:
        line, end, rest = bytes(self._buffer).partition(b"\r")
        if not end:
            return None
        self._buffer[:] = rest
        return bytes(byte for byte in line if byte > 0x20).decode("ascii", "replace")

    def _packet(self) -> str | None:
        while self._buffer:
            if self._buffer[0] != 2:
                del self._buffer[0]
                continue
            if len(self._buffer) < 2 or len(self._buffer) < 1 + self._buffer[1]:
                return None
            whole = bytes(self._buffer[1 : 1 + self._buffer[1]])
            if len(whole) >= 4 and whole[-1] == 3 and crc(whole[1:-3]) == int.from_bytes(whole[-3:-1], "big"):
                del self._buffer[: 1 + len(whole)]
                return whole[1:-3].decode("ascii", "replace")
            if self._tells_damage and len(whole) >= 4 and whole[-1] == 3:
                del self._buffer[: 1 + len(whole)]
                return DAMAGED
            del self._buffer[0]
        return None
