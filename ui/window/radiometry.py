"""From counts to radiance, as far as the last fit allows."""

from ui.window.watched import SeenFrame


class Radiometry:
    """Counts of no light, from the last dark frame, and counts per ms and W/mm²/sr, from the last fit's gain."""

    def __init__(self) -> None:
        self.gain: float | None = None
        self.dark: float | None = None

    def words(self, counts: int, frame: SeenFrame) -> str:
        """The radiance of a pixel in words."""
        if self.gain is None:
            return "radiance after the first fit"
        if self.dark is None:
            return "radiance after the first dark frame"
        per_ms = (counts - self.dark) / (frame.settings.exposure_ms * frame.settings.gain or 1.0)
        return f"{per_ms / self.gain:.3g} W/mm²/sr"
