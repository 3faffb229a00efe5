"""What a run is going to photograph: its patterns as fits see them, its doses, and how frames are put together to bins.

It is known before the run, or read from what it recorded.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tankrig.bench import Bench, KnownScenes
from tankrig.calibration.radiometry import Radiometry
from tankrig.checked_toml import checked
from tankrig.devices import CameraSettings, Pixels
from tankrig.errors import SceneError, StoreError
from tankrig.image.bins import HALF, Bins, Seen, bins_for
from tankrig.materials.coefficients import optics
from tankrig.materials.dosing import tank_volume_ml
from tankrig.materials.library import material
from tankrig.pattern import Pattern
from tankrig.run.calibrations import radiometry_of_run
from tankrig.run.reading import Run
from tankrig.scene.description import Camera, Medium, Scene, Tank
from tankrig.scene.outline import edge_reach_mm
from tankrig.scene.phase_table import PhaseFunction
from tankrig.sequence import Burst, Capture, Dose, Sequence
from tankrig.sequence.loading import sequence_from_table

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DOSE = 5
"""Numbers that are kept of each dose."""
MIXING = 3
"""Numbers that are kept of a picture of ink that has nearly mixed."""
ANY = Medium(0.001, 0.01, 0.5)
"""Of scenes whose medium is to be found."""


@dataclass(frozen=True)
class PhotographPlan:
    """What a run is going to photograph; plain enough to be sent to another process.

    Parameters
    ----------
    bench
        Of the rig; of a run that was imported, the scenes that came with it.
    patterns
        By hash, in the order of the sums.
    doses_ml
        Ink in the tank, as the sequence means to dose it, rising.
    settings
        Of the camera in each step of the sequence.
    radiometry
        Of the camera, where it was calibrated for all of them.
    more_doses
        How many different ones a run has recorded already, foreseen or not.
    saturation
        Count from which on the camera's pixels are saturated, where that is known.
    ink
        What is expected of it, per mm and ml; None where nothing is. Only which models are prepared rests on it.
    phase
        Which phase functions are fitted, as in `tankrig.estimate`.
    phase_said
        Whether somebody said so, or said what the ink is.
    sheet_ends
        Numbers of the steps after which all waves of a sheet are recorded.
    """

    bench: Bench | KnownScenes
    patterns: dict[str, Pattern]
    doses_ml: tuple[float, ...]
    settings: tuple[CameraSettings, ...]
    radiometry: Radiometry | None = None
    more_doses: int = 0
    saturation: float | None = None
    ink: Medium | None = None
    phase: str | PhaseFunction = "hg"
    phase_said: bool = False
    sheet_ends: frozenset[int] = frozenset()

    @classmethod
    def of(
        cls,
        bench: Bench,
        sequence: Sequence,
        patterns: list[Pattern],
        radiometry: Radiometry | None = None,
    ) -> "PhotographPlan":
        """For a sequence on a bench.

        Waves of a `separate` step are not photographs: each would need a model of its own, and all of them together
        tell a fit little more than one sheet does. `tankrig.separation` is what reads them.
        """
        patterns = [one for one in patterns if one.name not in sequence.waves]
        actions = [task.action for task in sequence.tasks]
        unused = CameraSettings(1.0)
        settings = tuple(
            sequence.camera_settings(one) if isinstance(one, Capture | Burst) else unused for one in actions
        )
        gains = {one.gain for one in settings if one is not unused}
        if radiometry is not None and not all(radiometry.knows(gain) for gain in gains):
            radiometry = None
        doses = tuple(one.total_ul / 1000.0 for one in actions if isinstance(one, Dose))
        return cls(
            bench, {pattern.hash: pattern for pattern in patterns}, doses, settings, radiometry,
            ink=ink_expected(sequence, bench.tank), phase=phase_of(sequence),
            phase_said=sequence.phase is not None or phase_of(sequence) != "hg", sheet_ends=sequence.sheet_ends,
        )  # fmt: skip

    @classmethod
    def of_run(cls, run: Run) -> "PhotographPlan":
        """For a run that was recorded."""
        conditions = run.conditions.values()
        more_doses, saturation = len({one.tank.volume_ul for one in conditions}), run.settings.get("saturation")
        if "scenes" in run.settings:
            known = KnownScenes(run.scenes)
            return cls(known, run.patterns, (), (), more_doses=more_doses, saturation=saturation)
        bench = checked(Bench, dict(run.settings["bench"]), f"{run.path}: its bench", StoreError)
        sequence = sequence_from_table(dict(run.settings["sequence"]), str(run.path))
        radiometry = radiometry_of_run(run)
        if radiometry is not None and not all(radiometry.knows(one.camera.gain) for one in conditions if one.camera):
            radiometry = None
        plan = cls.of(bench, sequence, list(run.patterns.values()), radiometry)
        return replace(plan, more_doses=more_doses, saturation=saturation)

    @property
    def doses(self) -> int:
        """How many different ones there can be: those recorded, those to come, what the tank held before, and one that
        a person has set right."""
        return 2 + len(self.doses_ml) + self.more_doses

    @property
    def lights_anything(self) -> bool:
        """Whether any of it can tell a fit something: a pattern that is not dark, or whole sheets of waves."""
        return bool(self.sheet_ends) or any(pattern.pixels.any() for pattern in self.patterns.values())

    @cached_property
    def scenes(self) -> dict[str, Scene]:
        """What the fit sees of the patterns that light anything, by hash; the media mean nothing."""
        whole = self._whole_scenes.items()
        return {key: Scene(scene.tank, ANY, scene.projector, self.camera) for key, scene in whole}

    @cached_property
    def _whole_scenes(self) -> dict[str, Scene]:
        """The same with the whole camera."""
        lit = {key: pattern for key, pattern in self.patterns.items() if pattern.pixels.any()}
        scenes = {key: self.bench.scene(pattern, ANY) for key, pattern in lit.items()}
        if len(lit) == len(self.patterns):
            return scenes
        # What the dark pattern shows is subtracted, and the light of dark parts of a picture is in it.
        return {
            key: replace(scene, projector=replace(scene.projector, black_level=0.0)) for key, scene in scenes.items()
        }

    @cached_property
    def _seen(self) -> dict[str, Seen]:
        """What is seen of each lit pattern's scene, by the pattern's hash."""
        return {key: Seen.of(scene) for key, scene in self._whole_scenes.items()}

    @cached_property
    def bins(self) -> Bins:
        """That frames are put together to."""
        return bins_for(self.bench.camera, list(self._seen.values()))

    @cached_property
    def camera(self) -> Camera:
        """The camera as the fit sees it."""
        return self.bins.camera(self.bench.camera)

    @cached_property
    def counts(self) -> dict[str, Mask]:
        """(rows, columns) bins that count for a fit, by the hash of the pattern.

        Left out are bins that blur matters to, in any of their pixels, and bins most of whose pixels are hot.
        """
        healthy = self.bins.shares(self._healthy) > HALF if self._healthy is not None else True
        return {key: (self.bins.shares(seen.sharp) == 1.0) & healthy for key, seen in self._seen.items()}

    @cached_property
    def _healthy(self) -> Mask | None:
        """(rows, columns) pixels that are not hot; None where all are, as far as is known."""
        hot = self.radiometry.hot if self.radiometry is not None else np.zeros(0, bool)
        return ~hot if hot.any() else None

    def require_left(self) -> None:
        """Refuse patterns that lenses blur so far that nothing of their light is left to fit.

        Raises
        ------
        SceneError
            Naming how far it blurs, and what to do.
        """
        for key, seen in self._seen.items():
            if seen.nothing_left:
                raise SceneError(
                    f"camera and projector blur light to {edge_reach_mm(self._whole_scenes[key]):.2g} mm on either "
                    "side of an edge, which leaves nothing of its light to fit; make its stripes or rays wider, or "
                    "focus and calibrate anew"
                )

    @property
    def may_go_further(self) -> bool:
        """Whether another phase function is fitted where Henyey–Greenstein's does not hold: unless somebody has said
        which to fit."""
        return not self.phase_said

    @property
    def size(self) -> int:
        """Numbers that the sums take."""
        rows, columns = self.camera.shape
        sums = self.doses * DOSE + self.doses * len(self.patterns) * (1 + 3 * rows * columns)
        return 3 + sums + MIXING + 2 * rows * columns

    def binned(self, pixels: Pixels, settings: CameraSettings) -> tuple[Array, Mask]:
        """A frame as the fit sees it: counts per ms at gain 1, made proportional to radiance where that is known.

        Each bin is the mean of its pixels that are not hot.

        Parameters
        ----------
        pixels
            (rows, columns) counts.
        settings
            Of the camera, as read back.

        Returns
        -------
        (rows, columns) of the bins, and which of them neither hold nor adjoin a saturated pixel

        Raises
        ------
        StoreError
            When the camera was calibrated, but not at this gain.
        """
        below = self.bins.clear_of(self._saturated(pixels, settings))
        if self.radiometry is not None:
            return self.bins.means(self.radiometry.light(pixels, settings), self._healthy), below
        per_ms = self.bins.size * settings.exposure_ms * settings.gain
        return self.bins.sums(pixels) / per_ms, below

    def _saturated(self, pixels: Pixels, settings: CameraSettings) -> Mask:
        full = np.asarray(pixels >= (np.inf if self.saturation is None else self.saturation))
        return full if self.radiometry is None else full | self.radiometry.saturated(pixels, settings)


def phase_of(sequence: Sequence) -> str | PhaseFunction:
    """Which phase functions the fits of a sequence's run search: those asked for, the material's, or the ink's.

    Raises
    ------
    SceneError
        When the material is unknown, or nobody has published what it is at the wavelength.
    """
    if sequence.phase is not None:
        return sequence.phase
    if sequence.material and sequence.wavelength_nm is not None:
        return optics(material(sequence.material), sequence.wavelength_nm).searched
    ink = sequence.ink
    return "hg" if ink is None or ink.phase is None else ink.phase


def ink_expected(sequence: Sequence, tank: Tank) -> Medium | None:
    """What a sequence says of its ink, per mm and ml; else what is published of its material, undiluted.

    Raises
    ------
    SceneError
        When the material is unknown, or nobody has published what it is at the wavelength.
    """
    if sequence.ink is not None or not sequence.material or sequence.wavelength_nm is None:
        return sequence.ink
    known, tank_ml = optics(material(sequence.material), sequence.wavelength_nm), tank_volume_ml(tank)
    stock = replace(known.medium, sigma_a=known.medium.sigma_a / tank_ml, sigma_s=known.medium.sigma_s / tank_ml)
    # Spheres are searched all about their label, not next to it.
    return Medium(*stock.coefficients) if isinstance(known.searched, PhaseFunction) else stock
