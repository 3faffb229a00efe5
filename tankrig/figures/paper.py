"""The paper's figures and comparison, from reference images: observations, reconstructions by order, single scattering.

A reference image is `NAME.npz` (array `total`, W/mm²/sr) with its scene, `NAME.toml`, whose medium is the truth.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tankrig.estimation.estimate import Estimate, estimate
from tankrig.estimation.result import Reconstruction, by_order
from tankrig.estimation.stated_errors import FINE
from tankrig.figures.fit_figure import draw_reconstructions
from tankrig.figures.tank_image import FALSE_COLOUR, GREY, STYLE, Image, brightness, draw, label_outer
from tankrig.files import whole_file
from tankrig.image.predict import predict
from tankrig.image.reading import read_image
from tankrig.scene import Scene, load_scene

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NOISE = 0.002
"""Standard deviation added to a reference image, as a share of its peak."""


@dataclass(frozen=True)
class Observed:
    """A reference image with camera noise added.

    Parameters
    ----------
    name
        Of the case.
    scene
        With the true medium.
    image
        Reference radiance plus noise, W/mm²/sr.
    noise
        Its standard deviation.
    """

    name: str
    scene: Scene
    image: Image
    noise: float


def observed(case: Path, seed: int = 0) -> Observed:
    """Read a reference case and add camera noise of `NOISE` of its peak.

    Parameters
    ----------
    case
        The .npz; the scene is the .toml beside it.
    seed
        Of the noise.
    """
    radiance = read_image(case)
    noise = NOISE * float(radiance.max())
    noisy = radiance + np.random.default_rng(seed).normal(0.0, noise, radiance.shape)
    return Observed(case.stem, load_scene(case.with_suffix(".toml")), noisy, noise)


def fitted(one: Observed, model: str = "tank", gain_known: bool = True) -> Estimate:
    """Fit a model to a reference image; its true medium is not used."""
    if gain_known:
        return estimate(one.image, one.scene, gain=1.0, offset=0.0, noise=one.noise, model=model)
    return estimate(one.image, one.scene, noise=one.noise, model=model)


def rebuilt(one: Observed, fit: Estimate) -> tuple[Reconstruction, ...]:
    """Reconstructions by order at a fit's medium, gain and offset."""
    return by_order(fit, predict(replace(one.scene, medium=fit.medium), "tank", FINE))


def collimated_cases(folder: Path) -> Iterator[Path]:
    """Reference cases with collimated light and no reflecting surface, by name."""
    for case in sorted(folder.glob("*.npz")):
        scene = load_scene(case.with_suffix(".toml"))
        if scene.projector.kind == "collimated" and scene.tank.surface == "matched":
            yield case


def paper_figures(dense: Observed, thin: Observed, fits: Sequence[Estimate], out: Path) -> list[Path]:
    """Draw Figs. 5, 6 and 7 of the paper.

    Parameters
    ----------
    dense, thin
        What to show as high and low density.
    fits
        Their fits, in that order.
    out
        Folder for figure5.png, figure6.png (thin) and figure7.png (dense).

    Returns
    -------
    The files written.
    """
    import matplotlib
    from matplotlib.figure import Figure

    files = [out / f"figure{number}.png" for number in (5, 6, 7)]
    with matplotlib.rc_context(STYLE):
        five = Figure(figsize=(8.4, 5.8), layout="constrained")
        _draw_observations(five, (dense, thin))
        six, seven = (Figure(figsize=(18.0, 5.6), layout="constrained") for _ in range(2))
        _draw_by_order(six, thin, fits[1])
        _draw_by_order(seven, dense, fits[0])
        for file, figure in zip(files, (five, six, seven), strict=True):
            with whole_file(file) as unfinished:
                figure.savefig(unfinished, dpi=120)
    return files


def _draw_observations(figure: "Figure", observations: Sequence[Observed]) -> None:
    axes = figure.subplots(2, 2, squeeze=False)
    for row, one in zip(axes, observations, strict=True):
        medium, scale = one.scene.medium, brightness(one.image)
        density = f"$\\sigma_t$ = {medium.sigma_t:.3g} /mm, g = {medium.g:g}"
        draw(row[0], one.image, one.scene, GREY, scale, density)
        draw(row[1], one.image, one.scene, FALSE_COLOUR, scale, "In false colour")
    label_outer(axes.tolist())


def _draw_by_order(figure: "Figure", one: Observed, fit: Estimate) -> None:
    axes = figure.subplots(2, 5, squeeze=False)
    percent = 100.0 / float(one.image.max())
    draw(axes[0, 0], percent * one.image, one.scene, FALSE_COLOUR, brightness(percent * one.image), "Observed")
    label_outer([[axes[0, 0]]])
    axes[1, 0].axis("off")
    sd = np.sqrt(np.diag(fit.covariance))
    numbers = [
        f"$\\{symbol}$ = {value:.3g} ± {error:.1g} /mm" if symbol != "g" else f"$g$ = {value:.3f} ± {error:.1g}"
        for symbol, value, error in zip(
            ("sigma_a", "sigma_s", "g"), (fit.medium.sigma_a, fit.medium.sigma_s, fit.medium.g), sd, strict=True
        )
    ]
    axes[1, 0].text(0.0, 0.95, "\n".join(numbers), va="top", fontsize=12, linespacing=1.6)
    draw_reconstructions(axes[:, 1:].tolist(), one.scene, rebuilt(one, fit), one.image, one.noise)
