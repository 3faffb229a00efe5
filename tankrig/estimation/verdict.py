"""What a person should know about a fit of one image or of a series, in plain sentences."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.coordinates import NAMES
from tankrig.estimation.misfit import STRAY
from tankrig.estimation.phase_families import CONE_DEG
from tankrig.estimation.result import Linearity
from tankrig.estimation.uncertainty import DETERMINED, END, extinction, reduced_scattering
from tankrig.scene import Medium

SYMBOLS = {"sigma_a": "σa", "sigma_s": "σs", "g": "g"}
HALO = f"lens or air spread {100.0 * STRAY:.2g} % of the light into a wide halo"
"""What nobody has measured on most benches."""
TOO_LIKELY = -3.0
"""Logarithm of how many times likelier another phase function is from which on a verdict speaks of it."""
SLIGHT = 0.005
"""Share of the image up to which structure is no reason to say that the model does not hold: intervals count it."""
MUCH_LEFT_OUT = 0.1
"""Share of the light from which on it matters more than anything else that the model leaves it out."""
TELLING_MOVE = 1.0
"""Standard deviations of a coefficient by which a cause moves it before it is no noise."""


def what_is_determined(
    medium: Medium, spread: NDArray[np.float64], known: Mapping[str, bool], edges: Sequence[str], combined: bool = True
) -> str:
    """One or two sentences: which coefficients the data determine and, where not all, which combination they do.

    Parameters
    ----------
    medium, spread
        What was found, and its covariance.
    known
        Which coefficients count as determined.
    edges
        Which are as small or large as they may be.
    combined
        Whether combinations may count so: what no phase function describes moves them as well.
    """
    yes = [SYMBOLS[name] for name in NAMES if known[name]]
    no = [SYMBOLS[name] for name in NAMES if not known[name]]
    edge = _at_edges(medium, edges)
    if not no:
        return f"σa, σs and g are all determined.{edge}"
    text = f"{_listed(yes)} {'is' if len(yes) == 1 else 'are'} determined, {_listed(no)} not" if yes else (
        "The image determines neither σa nor σs nor g"
    )  # fmt: skip
    combinations = [
        f"{name} = {value:.4g} ± {sd:.2g} /mm"
        for name, (value, sd), wanted in (
            ("σs(1−g)", reduced_scattering(medium, spread), not (known["sigma_s"] and known["g"])),
            ("σt = σa+σs", extinction(medium, spread), not known["sigma_s"]),
        )
        if combined and wanted and sd <= DETERMINED * value
    ]
    if combinations:
        text += f"; {_listed(combinations)} {'is' if len(combinations) == 1 else 'are'} determined all the same"
    bound = medium.sigma_a + 2.0 * math.sqrt(float(spread[0, 0]))
    if yes and not known["sigma_a"]:
        text += f"; σa is below {bound:.2g} /mm"
    return f"{text}.{edge}"


def what_is_left(
    structure: float,
    stated: float,
    noisier: float,
    cause: tuple[str, float] | None = None,
    place: tuple[float, int, int] | None = None,
    aside: bool = False,
    shown: bool = False,
    others: Sequence[str] = (),
) -> str:
    """What the residual says, in one or two sentences; nothing where it is noise but for a cause that it shows.

    Parameters
    ----------
    structure
        What neighbouring pixels of the residual have in common, as a share of the image (relative L2).
    stated
        The model's own error, likewise.
    noisier
        The residual's white part over the noise assumed; 1 where they agree.
    cause
        What the structure looks like, and the share of it that this explains; None where it looks like nothing known.
    place
        Where it stands out most: standard deviations, row and column; None where it does so nowhere.
    aside
        Whether pixels that were left out hold structure.
    shown
        Whether it shows a cause, see `what_is_shown`.
    others
        Causes that are nearly as likely as that one.

    Examples
    --------
    >>> print(what_is_left(0.002, 0.001, 1.0))
    The residual holds structure of 0.2 % of the image that neither noise nor the model's own error of 0.1 % explains;
    what that may do to the coefficients is in their intervals.
    """
    sentences = []
    if stated < structure <= SLIGHT:
        sentences.append(
            f"The residual holds structure of {_percent(structure)} of the image that neither noise nor the model's "
            f"own error of {_percent(stated)} explains; what that may do to the coefficients is in their intervals."
        )
    elif structure > stated:
        sentences.append(
            f"The residual holds structure of {_percent(structure)} of the image that neither noise nor the model's "
            f"own error of {_percent(stated)} explains: the model does not hold as described (uneven ink, a misaligned "
            "beam, another phase function, a wrong gain or offset), and the intervals are widened by it."
        )
    elif place is not None:
        sentences.append(
            f"The residual holds structure around row {place[1]}, column {place[2]}: it stands out there by "
            f"{place[0]:.2g} standard deviations of noise and the model's own error. Something is not as described "
            "(a misaligned beam or camera, a reflection, a bubble), and the intervals do not count that."
        )
    elif structure > 0.0:
        sentences.append(
            f"The residual's structure, {_percent(structure)} of the image, is within the model's own error of "
            f"{_percent(stated)}."
        )
    if cause:
        alike = f" It may as well be {' or '.join(others)}." if others else ""
        sentences.append(f"It looks most like {cause[0]}, which would explain {100.0 * cause[1]:.0f} % of it.{alike}")
    if noisier > 1.0:
        sentences.append(f"The noise is {noisier:.3g} times what was assumed, and counted so.")
    if shown and not sentences:
        return ""
    return " ".join(sentences) or (
        "The residual of the pixels that count is noise." if aside else "The residual is noise, as expected."
    )


def what_was_left_out(
    saturated: int, outliers: int, share_left_out: float, model: str, misaligned: bool = False
) -> str:
    """Sentences about pixels that don't count and light that the model does not describe; empty when there are none.

    Parameters
    ----------
    saturated, outliers
        Numbers of pixels.
    share_left_out
        Of the light, by the model.
    model
        Its name.
    misaligned
        Whether the outliers look like what a misaligned beam or camera shows.

    Examples
    --------
    >>> what_was_left_out(1, 0, 0.0, "tank")
    '1 pixel at the highest value or within its noise was taken for saturated and left out; shorten the exposure.'
    >>> what_was_left_out(0, 1, 0.0, "tank")[:55], what_was_left_out(0, 2, 0.0, "tank")[-14:]
    ('1 pixel unlike its neighbours along the light (bubbles,', 'were left out.')
    """
    sentences = []
    if outliers:
        unlike, was = ("pixel unlike its", "was") if outliers == 1 else ("pixels unlike their", "were")
        sentences.append(
            f"{outliers} {unlike} neighbours along the light (bubbles, dust, reflections, dead pixels) {was} left out."
        )
    if misaligned:
        sentences.append(
            "The residual holds structure there: most of what they are off by is what a misaligned beam or camera "
            "shows, not bubbles."
        )
    if saturated:
        were = "pixel at the highest value or within its noise was" if saturated == 1 else (
            "pixels at the highest value or within its noise were"
        )  # fmt: skip
        sentences.append(f"{saturated} {were} taken for saturated and left out; shorten the exposure.")
    if share_left_out > MUCH_LEFT_OUT:
        amount = f"up to {_percent(share_left_out)}" if math.isfinite(share_left_out) else "an unknown share"
        sentences.append(
            f'The "{model}" model leaves out {amount} of the light: the coefficients are those that make it fit, '
            "not the liquid's."
        )
    return " ".join(sentences)


def what_may_peak_unseen(outside_cone: tuple[float, float] | None, unit: str = "/mm") -> str:
    """A sentence for a liquid that may scatter much of its light nearly straight on; empty where it does not.

    Parameters
    ----------
    outside_cone
        σs of what turns by more than `CONE_DEG`, and its standard deviation; None of other liquids.
    unit
        Of both.
    """
    if outside_cone is None:
        return ""
    value, sd = outside_cone
    return (
        f"The liquid may turn much of its light by less than {CONE_DEG:g}°, as natural waters do, and no image tells "
        f"that from light that was not scattered: compare σs beyond {CONE_DEG:g}° = {value:.4g} ± {sd:.2g} {unit}, "
        "neither σs nor g."
    )


def what_is_misaligned(found: Mapping[str, tuple[float, float]]) -> str:
    """A sentence for what turned out to be off by more than twice its error; empty when nothing did."""
    off = [
        f"{name} = {value:+.2g} ± {sd:.1g}" for name, (value, sd) in found.items() if abs(value) > 2.0 * sd
    ]  # fmt: skip
    return f"The set-up is not as described, and was corrected: {', '.join(off)}." if off else ""


def what_is_unseen(
    medium: Medium, moved: NDArray[np.float64], spread: NDArray[np.float64], known: Mapping[str, bool],
    what: str = HALO,
) -> str:  # fmt: skip
    """A sentence on what nobody has measured; empty where the intervals hold what it would do.

    Parameters
    ----------
    medium
        That was found.
    moved
        (3,) how far a halo of `misfit.STRAY` that no residual shows would move σa, σs and g.
    spread
        Their covariance, (3, 3) at least.
    known
        By name, whether it is determined.
    what
        Would be, "if …".
    """
    beyond = [
        (name, by)
        for name, by, variance in zip(NAMES, moved, np.diag(spread), strict=False)
        if known[name] and by > END * math.sqrt(float(variance))
    ]
    if not beyond:
        return ""
    return (
        f"Not in the intervals, since nothing here measures it: if {what}, the residual would not show it, and "
        f"{_moves(medium, beyond)} could be off."
    )


def what_is_shown(
    medium: Medium, name: str, deviations: float, moved: NDArray[np.float64], spread: NDArray[np.float64],
    others: Sequence[str] = (),
) -> str:  # fmt: skip
    """A sentence on a cause that a residual shows, although it is no more than noise by its size.

    Parameters
    ----------
    medium
        That was found.
    name
        Of the cause.
    deviations
        By how many standard deviations it is seen.
    moved
        (3,) what it moves σa, σs and g by.
    spread
        Their covariance without it.
    others
        Causes that are nearly as likely; `moved` is of the one that moves them most.
    """
    beyond = [
        (which, abs(float(by)))
        for which, by, variance in zip(NAMES, moved, np.diag(spread), strict=False)
        if abs(by) > TELLING_MOVE * math.sqrt(float(variance))
    ]
    return (
        f"The residual shows {' or '.join([name, *others])} by {abs(deviations):.2g} standard deviations, which the "
        "scene does not describe: "
        f"{_moves(medium, beyond)} would be off by it, and the intervals are widened by that. Measure it, or fit it "
        "along."
    )


def what_did_not_hold(explained: float) -> str:
    """A sentence before the verdict of a fit that weighs families because Henyey–Greenstein did not hold.

    Parameters
    ----------
    explained
        Share of the structure left by Henyey–Greenstein that another phase function explains.
    """
    return (
        f"Another phase function explains {100.0 * explained:.0f} % of what Henyey–Greenstein leaves, so families "
        "of them were weighed."
    )


def what_spheres_do() -> str:
    """A sentence before the verdict of a fit of spheres that takes the place of a free phase function's."""
    return "Spheres of one kind describe the image as well as any smooth phase function does, or better."


def what_no_phase_describes(undescribed: bool, rough: bool) -> str:
    """A sentence for a fit of a free phase function that leaves structure, or is rougher than free ones are expected to
    be; empty for others."""
    if not undescribed:
        return ""
    why = (
        "The phase function found is rougher than smooth ones are, and what of it is finer still is not described"
        if rough
        else "Not even a free phase function describes the image"
    )
    return (
        f"{why}, so neither σs nor g counts as determined: fit with the particles' label, or look for what else is not "
        "as described."
    )


def what_phase_is_shown(evidence: float, shown: bool) -> str:
    """A sentence for a Henyey–Greenstein fit whose residual is noise by its size, where another phase function is
    likelier all the same, or too likely to be left out; empty for others.

    Parameters
    ----------
    evidence
        Logarithm of how many times likelier a free one is.
    shown
        Whether that is beyond doubt.
    """
    if shown:
        return (
            "The residual shows another phase function than Henyey–Greenstein's, which is "
            f"{_times(evidence)} less likely, so neither σs nor g counts as determined: fit again with a free phase "
            "function (--phase free), or with the material that it is."
        )
    if evidence < TOO_LIKELY:
        return ""
    return (
        f"The image hardly tells Henyey–Greenstein's phase function from others ({_times(abs(evidence))} "
        f"{'less' if evidence > 0.0 else 'more'} likely), and the intervals count what these would say."
    )


def what_was_hardly_told() -> str:
    """A sentence before the verdict of a fit that weighs families because the image hardly tells them apart."""
    return "The image hardly tells Henyey–Greenstein's phase function from others, so families of them were weighed."


def _times(evidence: float) -> str:
    """How many times likelier, in words."""
    return f"{math.exp(evidence):.2g} times" if evidence < math.log(1000.0) else "more than a thousand times"


def what_has_not_settled(unsettled: bool) -> str:
    """A sentence for a fit of a phase function that its last exact image still moved, or that explains the image no
    better than another one of its family does elsewhere; empty for others."""
    if not unsettled:
        return ""
    return (
        "The fit has not settled: its last exact image still moved it by more than chance, or another phase function "
        "of the family explains the image as well, which the intervals count, so neither σs nor g counts as "
        "determined. Say more of the phase function: the particles' label, a smaller spread on it, or one family."
    )


def what_may_be_another_phase(doubted: bool) -> str:
    """A sentence for a Henyey–Greenstein fit that leaves more than a bench's usual faults do; empty for others."""
    if not doubted:
        return ""
    return (
        "The ink may well have another phase function than Henyey–Greenstein's, so neither σs nor g counts as "
        "determined: fit again with a free phase function (--phase free), or with the material that it is."
    )


def _moves(medium: Medium, beyond: Sequence[tuple[str, float]]) -> str:
    """ "σs by 2 % and g by .01"."""

    def said(name: str, by: float) -> str:
        if name == "g":
            return f"g by {by:.2g}"
        return f"{SYMBOLS[name]} by {_percent(by / max(getattr(medium, name), 1e-300))}"

    return _listed([said(name, by) for name, by in beyond])


def _at_edges(medium: Medium, edges: Sequence[str]) -> str:
    sentences = []
    for name in edges:
        if name == "sigma_a" and medium.albedo > 0.5:
            sentences.append(" σa is not distinguishable from zero.")
        else:
            value = f"{getattr(medium, name):.3g}"
            sentences.append(f" {SYMBOLS[name]} ended at the edge of the range searched, {value}: don't trust it.")
    return "".join(sentences)


def _listed(parts: list[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 1.0 else f"{100.0 * share:.0f} %"


def series_verdict(
    water: float,
    spread: NDArray[np.float64],
    known: Mapping[str, bool],
    linearity: Linearity | None,
    left: tuple[float, float, float],
) -> str:
    """What is determined, whether the ink acts in proportion to its dose, and what the residuals say.

    Parameters
    ----------
    water
        Its σa, 1/mm.
    spread
        (4, 4) covariance, of the ink's σa, σs and g, and the water's σa.
    known
        By name, whether it is determined.
    linearity
        None where it could not be tested.
    left
        Arguments of `what_is_left`.
    """
    yes = [symbol for name, symbol in SYMBOLS.items() if known[name]]
    no = [symbol for name, symbol in SYMBOLS.items() if not known[name]]
    sentences = []
    if not no:
        sentences.append("The series determines σa and σs of the ink per ml, and g.")
    else:
        determined = f"{_listed(yes)} of the ink, but not {_listed(no)}" if yes else "nothing of the ink"
        sentences.append(
            f"The series determines {determined}: take images at lower and higher doses, or with more patterns."
        )
    sd = math.sqrt(float(spread[3, 3]))
    if known["water_sigma_a"]:
        sentences.append(f"Water alone absorbs {water:.3g} ± {sd:.1g} /mm.")
    else:
        sentences.append(f"The water's own absorption is below {water + 2.0 * sd:.1g} /mm.")
    if linearity is None:
        sentences.append("Two doses cannot show whether the ink acts in proportion to its dose.")
    else:
        bend = f"{100.0 * linearity.bend:+.2g} ± {100.0 * linearity.sd:.1g} % at the highest dose"
        sentences.append(
            f"The ink acts in proportion to its dose ({bend})." if linearity.holds else
            f"The ink does not act in proportion to its dose ({bend}): the doses are wrong, the ink had not mixed, or "
            "it clumps or settles; the coefficients are not to be trusted."
        )  # fmt: skip
    sentences.append(what_is_left(*left))
    return " ".join(sentences)
