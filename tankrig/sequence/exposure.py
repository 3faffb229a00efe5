"""Exposures and the projector's light: whole numbers of its periods, or a person's reason why not."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from tankrig.devices import CameraDevice, CameraSettings
from tankrig.errors import SequenceError
from tankrig.scene.description import CLOSED
from tankrig.sequence.sequence import Sequence
from tankrig.sequence.steps import MOST_EXPOSURE_MS, Capture, Mix

LEAST_PERIOD_MS = 1e-3
"""No projector's light comes and goes faster."""
_CLOSE = 0.005
"""Part of an exposure by which it may miss a whole number of periods; its light then errs by as much at most times the
light's peak over its mean. Cameras round exposures, and refresh rates are told to some digits."""


@dataclass(frozen=True)
class ExposureRule:
    """How the projector's light comes and goes, and whether exposures have to keep to that.

    A projector with a colour wheel, or with lamps that are switched, sends different light at different times of each
    period. Only an exposure of whole periods gathers the same light wherever in the period it begins.

    Parameters
    ----------
    period_ms
        Of the light; 0 for light that is steady; None where nobody has said.
    accept
        A person's reason why any exposure will do; empty where none has been given.
    """

    __pydantic_config__ = CLOSED
    period_ms: float | None = None
    accept: str = ""

    def __post_init__(self) -> None:
        if self.period_ms is not None and not (
            self.period_ms == 0.0 or LEAST_PERIOD_MS <= self.period_ms <= MOST_EXPOSURE_MS
        ):
            raise SequenceError(f"period_ms = {self.period_ms} is no time; give ms, or 0 for light that is steady")

    @property
    def holds(self) -> bool:
        """Whether there is anything to keep to."""
        return bool(self.period_ms) and not self.accept.strip()

    def allows(self, exposure_ms: float) -> bool:
        """Whether an exposure is a whole number of periods, to half a percent of itself.

        >>> rule = ExposureRule(1000.0 / 60.0)
        >>> rule.allows(16.7), rule.allows(50.0), rule.allows(20.0), ExposureRule(0.0).allows(20.0)
        (True, True, False, True)
        """
        if not self.holds:
            return True
        period_ms = self.period_ms or 0.0
        return abs(exposure_ms - max(1, round(exposure_ms / period_ms)) * period_ms) <= _CLOSE * exposure_ms

    def nearest_ms(self, exposure_ms: float) -> tuple[float, ...]:
        """Whole numbers of periods below and above an exposure, ms."""
        period_ms = self.period_ms or 0.0
        fewer = int(exposure_ms / period_ms)
        return tuple(number * period_ms for number in (fewer, fewer + 1) if number)

    def refusal(self, exposure_ms: float) -> str:
        """Why an exposure is refused, and what to do; empty where it is allowed."""
        if self.allows(exposure_ms):
            return ""
        period_ms = self.period_ms or 0.0
        near = " or ".join(f"{value:.3f}" for value in self.nearest_ms(exposure_ms))
        return (
            f"exposure_ms = {exposure_ms:g} is {exposure_ms / period_ms:.2f} periods of the projector's light "
            f"({period_ms:.3f} ms), so that brightness depends on when a frame began; give {near}, or say why it does "
            f"not matter (any_exposure in the sequence, accept in the rig file's [exposure])"
        )


def rule_for(sequence: Sequence, rule: ExposureRule) -> ExposureRule:
    """The rig's rule, unless the sequence accepts any exposure."""
    return replace(rule, accept=rule.accept or sequence.any_exposure)


def require_whole_periods(sequence: Sequence, rule: ExposureRule) -> None:
    """Check the exposures that a sequence asks for.

    Raises
    ------
    SequenceError
        Naming the first step that would flicker, and the exposures nearest to it that would not.
    """
    rule = rule_for(sequence, rule)
    for label, settings in _exposures(sequence):
        if refusal := rule.refusal(settings.exposure_ms):
            raise SequenceError(f"{sequence.called}: {label}: {refusal}")


def require_camera_keeps(sequence: Sequence, rule: ExposureRule, camera: CameraDevice) -> None:
    """Check what the camera makes of the exposures that a sequence asks for: it may round them without a word.

    Raises
    ------
    SequenceError
        Naming the first step whose true exposure is no whole number of periods.
    """
    rule = rule_for(sequence, rule)
    if not rule.holds:
        return
    seen = set()
    for label, settings in _exposures(sequence):
        if settings not in seen:
            seen.add(settings)
            actual_ms = camera.configure(settings).exposure_ms
            if refusal := rule.refusal(actual_ms):
                asked = f"{camera.name} makes {actual_ms:g} ms of exposure_ms = {settings.exposure_ms:g}"
                raise SequenceError(f"{sequence.called}: {label}: {asked}: {refusal}")


def _exposures(sequence: Sequence) -> Iterator[tuple[str, CameraSettings]]:
    for task in sequence.tasks:
        if isinstance(task.action, Capture | Mix):
            yield task.label, sequence.camera_settings(task.action)
