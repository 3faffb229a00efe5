"""What a source has found, as people read it: one number style, one confidence, and whose result it is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tankrig.estimation.phase_families import CONE_DEG
from tankrig.estimation.verdict import SYMBOLS
from tankrig.live.formatting import with_error
from tankrig.live.results import DoseFit, PhaseFound, SeriesFit
from tankrig.scene import Medium
from ui.window.phase_words import PARAMETERS, found_in_words

if TYPE_CHECKING:
    from ui.window.shown import Shown

NAMES = {"sigma_s": "σs", "sigma_a": "σa", "g": "g"}
MEAN_COSINE = "g, the mean cosine"
CONFIDENCE = "95 %"
Z = 1.96
"""Standard deviations on either side that hold 95 %."""
_PLACES = {"sigma_s": 1, "sigma_a": 0, "g": 2}
"""In the standard deviations of a fit."""
_MODELS = {"tank": "tank model", "prepared": "tank model, prepared"}


@dataclass(frozen=True)
class Coefficient:
    """One number of a result.

    Parameters
    ----------
    name, symbol, unit
        "sigma_s", "sigma_a", "g", "reduced" or a parameter's; σs, σa, g …; "per mm", "per mm and ml", or nothing.
    value, half
        Best value, and half of the 95 % interval; 0 of what was given, and not fitted.
    determined
        Whether the photographs determine it.

    Examples
    --------
    >>> Coefficient("g", "g", "", 0.7123456, 0.0021, True).text
    '0.7123 ± 0.0021'
    >>> Coefficient("water_index", "index of the water", "", 1.33, 0.0, True).text
    '1.33, as given'
    """

    name: str
    symbol: str
    unit: str
    value: float
    half: float
    determined: bool

    @property
    def text(self) -> str:
        """With digits from its uncertainty."""
        if self.half == 0.0:
            return f"{self.value:.6g}, as given"
        return with_error(self.value, self.half) if math.isfinite(self.half) else f"{self.value:.4g} ± unknown"


@dataclass(frozen=True)
class Result:
    """What was found, and what it belongs to.

    Parameters
    ----------
    title
        Of the source.
    of
        What the numbers are of: the ink, or the liquid with one dose.
    doses_ml, patterns
        That it rests on.
    model, phase, settings
        By which it was found: model of the light, phase function, and what was fitted and what subtracted.
    coefficients
        In the order in which they are shown.
    verdict
        Whether they are determined, in sentences.
    scattering
        What else was found of how the liquid scatters, where g does not say all of that: σs(1−g), and what describes
        the phase function.
    """

    title: str
    of: str
    doses_ml: tuple[float, ...]
    patterns: tuple[str, ...]
    model: str
    phase: str
    settings: str
    coefficients: tuple[Coefficient, ...]
    verdict: str
    scattering: tuple[Coefficient, ...] = ()

    @property
    def belongs(self) -> str:
        """One line that says whose numbers these are."""
        return f"{self.of} · {self.model} · {self.phase} · {self.settings}"

    @property
    def text(self) -> str:
        """As plain text."""
        lines = [self.title, self.belongs]
        for one in (*self.coefficients, *self.scattering):
            not_known = "" if one.determined else ", not determined"
            sure = f" ({CONFIDENCE}{not_known})" if one.half else ""
            lines.append(f"{one.symbol} = {one.text} {one.unit}".rstrip() + sure)
        return "\n".join([*lines, self.verdict])


def result_of(shown: "Shown") -> Result | None:
    """The best that a source has found: the ink, from all doses, or else the liquid of its newest dose."""
    if shown.series is not None:
        return _of_series(shown, shown.series)
    return None if shown.newest is None else of_dose(shown, shown.newest)


def of_dose(shown: "Shown", fit: DoseFit) -> Result:
    """The liquid with one dose."""
    of = f"liquid with {fit.dose_ml:.4g} ml of ink"
    known = {name: fit.identifiable.get(name, True) for name in _PLACES}
    model = _MODELS.get(fit.model, fit.model)
    return Result(
        shown.source.title, of, (fit.dose_ml,), fit.patterns, model, phase_in_words(fit.medium, fit.scattering),
        _settings(shown, fit.patterns), _coefficients(fit.medium, fit.sd, known, "per mm"), in_words(fit),
        _scattering(fit.medium, fit.scattering, "per mm"),
    )  # fmt: skip


def _of_series(shown: "Shown", fit: SeriesFit) -> Result:
    doses = ", ".join(f"{dose:.4g}" for dose in fit.doses_ml)
    known = {name: fit.identifiable.get(name, True) for name in _PLACES}
    patterns = tuple(dict.fromkeys(fit.patterns or (shown.newest.patterns if shown.newest is not None else ())))
    model = _MODELS.get(shown.newest.model, shown.newest.model) if shown.newest is not None else _MODELS["tank"]
    unlike = "".join(f" With {one.dose_ml:.4g} ml,{_unlike(one)}" for one in shown.by_dose if one.structure)
    return Result(
        shown.source.title, f"ink, from {doses} ml", fit.doses_ml, patterns, model,
        phase_in_words(fit.ink, fit.scattering), _settings(shown, patterns),
        _coefficients(fit.ink, fit.sd, known, "per mm and ml"), f"{fit.verdict}{unlike}",
        _scattering(fit.ink, fit.scattering, "per mm and ml"),
    )  # fmt: skip


def phase_in_words(medium: Medium, found: PhaseFound | None = None) -> str:
    """The phase function of a medium, by its family's name.

    >>> phase_in_words(Medium(0.0, 0.01, 0.7))
    'Henyey–Greenstein'
    """
    return found_in_words(medium.phase_function.kind, {} if found is None else found.families)


def in_words(fit: DoseFit) -> str:
    """Which coefficients a dose's fit determines, what of the light its model leaves, and what order 1 has against it.

    >>> known = {"sigma_a": False, "sigma_s": True, "g": True}
    >>> in_words(DoseFit(0.4, Medium(1e-4, 0.01, 0.7), identifiable=known, frames=12, patterns=("sheet",)))
    'With 0.4 ml, from 12 frames of sheet: σs and g are determined, σa is not yet; more dose or patterns tell more.'
    >>> said = "order 1 is brighter than the fitted liquid has it."
    >>> in_words(DoseFit(0.4, Medium(1e-4, 0.01, 0.7), frames=12, patterns=("sheet",), order_one=said))[-62:]
    'determined. Order 1 is brighter than the fitted liquid has it.'
    """
    known = [symbol for name, symbol in SYMBOLS.items() if fit.identifiable.get(name, True)]
    unknown = [symbol for symbol in SYMBOLS.values() if symbol not in known]
    head = f"With {fit.dose_ml:.4g} ml, from {fit.frames} frames of {', '.join(fit.patterns)}: "
    doubt = _unlike(fit)
    doubt += f" {fit.order_one[:1].upper()}{fit.order_one[1:]}" if fit.order_one else ""
    if not unknown:
        return f"{head}σs, g and σa are all determined.{doubt}"
    are = " and ".join(known) + (" are" if len(known) > 1 else " is") + " determined, " if known else ""
    rest = " and ".join(unknown) + (" are" if len(unknown) > 1 else " is") + " not yet"
    return f"{head}{are}{rest}; more dose or patterns tell more.{doubt}"


def _unlike(fit: DoseFit) -> str:
    """How much of the light is not as the model has it; empty where it is."""
    if not fit.structure:
        return ""
    return f" {100.0 * fit.structure:.2g} % of the light is not as the model has it, and counted in the errors."


def table(shown: "Shown") -> str:
    """All fits of a source, see `table_of`: each dose's, and that of the ink where there is one."""
    results = [of_dose(shown, fit) for fit in shown.by_dose]
    if shown.series is not None:
        results.append(_of_series(shown, shown.series))
    return table_of(results)


def table_of(results: Sequence[Result]) -> str:
    """Results as lines with tabs between, for a spreadsheet; the first line names the columns and their units."""
    head = ["source", "of", "dose (ml)", "patterns", "model", "phase function", "settings"]
    for name, symbol in NAMES.items():
        unit = "" if name == "g" else " (1/mm, of ink 1/mm/ml)"
        head += [f"{symbol}{unit}", f"{symbol} ± {CONFIDENCE}", f"{symbol} determined"]
    # Different results may have different phase functions: a column for each number that any of them has.
    further = {(number.name, number.symbol): number for one in results for number in one.scattering}
    for name, symbol in further:
        unit = " (1/mm, of ink 1/mm/ml)" if name == "reduced" else ""
        head += [f"{symbol}{unit}", f"{symbol} ± {CONFIDENCE}"]
    lines = [head]
    for one in results:
        doses = ", ".join(f"{dose:.6g}" for dose in one.doses_ml)
        row = [one.title, one.of, doses, ", ".join(one.patterns), one.model, one.phase, one.settings]
        for number in one.coefficients:
            row += [f"{number.value:.8g}", f"{number.half:.3g}", "yes" if number.determined else "no"]
        has = {(number.name, number.symbol): number for number in one.scattering}
        for column in further:
            row += [f"{has[column].value:.8g}", f"{has[column].half:.3g}"] if column in has else ["", ""]
        lines.append(row)
    return "\n".join("\t".join(line) for line in lines) + "\n"


def _coefficients(
    medium: Medium, sd: tuple[float, ...], known: dict[str, bool], unit: str
) -> tuple[Coefficient, ...]:  # fmt: skip
    symbols = SYMBOLS if medium.phase is None else {**SYMBOLS, "g": MEAN_COSINE}
    return tuple(
        Coefficient(
            name, symbols[name], "" if name == "g" else unit, float(getattr(medium, name)),
            Z * sd[place] if place < len(sd) else math.inf, known[name],
        )
        for name, place in _PLACES.items()
    )  # fmt: skip


def _scattering(medium: Medium, found: PhaseFound | None, unit: str) -> tuple[Coefficient, ...]:
    """σs(1−g), σs beyond a cone, and what describes the phase function; nothing of Henyey–Greenstein's, whose g says
    all."""
    if found is None:
        return ()
    follows = [Coefficient("reduced", "σs(1−g)", unit, found.reduced[0], Z * found.reduced[1], True)]
    if found.outside_cone is not None:
        value, sd = found.outside_cone
        follows.append(Coefficient("outside_cone", f"σs beyond {CONE_DEG:g}°", unit, value, Z * sd, True))
    most = max(found.families, key=lambda name: found.families[name], default=medium.phase_function.kind)
    words = PARAMETERS.get(most, {})  # where families share the answer, these are the heaviest's
    return *follows, *(
        Coefficient(name, words.get(name, name.replace("_", " ")), "", value, Z * sd, True)
        for name, (value, sd) in found.parameters.items()
    )


def _settings(shown: "Shown", patterns: tuple[str, ...]) -> str:
    if shown.source.settings is not None:
        return shown.source.settings.words
    offsets = {one.offset == 0.0 for one in shown.photographs.values()}
    background = {frozenset({True}): "; dark frames subtracted", frozenset({False}): "; background fitted"}
    return ", ".join(patterns) + background.get(frozenset(offsets), "")
