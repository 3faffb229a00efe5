"""Images of liquids with phase functions of many kinds, and fits of these by one."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tankrig.estimation.estimate import Estimate, fit_models
from tankrig.estimation.observation import observe
from tankrig.estimation.phase_answer import asked_for
from tankrig.estimation.scaling import Scaling
from tankrig.estimation.versions import Models
from tankrig.prediction import Prediction
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank
from tankrig.scene.mie import Mie
from tankrig.scene.phase_table import PhaseFunction
from tests.test_estimation import SCENE

Array = NDArray[np.float64]
LABEL = Mie(0.5, 1.58242, 1.3317, 633.0, spread=0.02)
Y, X = 4.0 * np.mgrid[-19.5:20.5, 0.5:60.5]
TURNS_DEG = np.arange(5.0, 176.0, 10.0)
TURNS = np.cos(np.radians(TURNS_DEG))


def many_turns(liquid: Medium) -> Prediction:
    """A beam by p(90°), pairs of turns that lie beside it each in their place, and a halo: a tank in closed form."""
    p = liquid.phase_function.at(TURNS)
    far = np.exp(-liquid.sigma_t * (X + 60.0))
    beam = float(liquid.phase_function.at(0.0)) * (np.abs(Y) < 3.0) * far
    places = np.exp(-(((np.abs(Y)[..., None] - 0.4 * TURNS_DEG) / (5.0 + 0.03 * X[..., None])) ** 2)) @ p
    halo = np.exp(-np.hypot(X, Y) * (0.01 + liquid.sigma_s * (1.0 - liquid.g)))
    sigma_s = liquid.sigma_s
    return Prediction(sigma_s * beam + 3.0 * sigma_s**2 * places * far + 300.0 * sigma_s**3 * halo * far, "tank-like")


LIQUIDS = Path(__file__).parent / "data" / "liquids"
THREE_BEAMS = tuple(Beam((low, low + 4.0), (58.0, 62.0)) for low in (-42.0, -2.0, 38.0))
TANK = Scene(Tank(), Medium(0.0, 0.0, 0.0), Projector("collimated", THREE_BEAMS), Camera("orthographic", (40, 60), 4.0))


def photographed(name: str) -> tuple[Array, Array]:
    """An independent Monte Carlo's image with .3 % of noise, and the noise of both, see its README."""
    with np.load(LIQUIDS / f"{name}.npz") as file:
        total, stderr = file["total"].astype(float), file["stderr"].astype(float)
    noise = 0.003 * float(total.max())
    return total + np.random.default_rng(1).normal(0.0, noise, total.shape), np.hypot(noise, stderr)


def fit(phase: PhaseFunction, asked: str | PhaseFunction, seed: int = 0, share: float = 0.003) -> Estimate:
    image = many_turns(Medium(0.001, 0.02, phase=phase)).image
    noise = share * float(image.max())
    seen = observe(image + np.random.default_rng(seed).normal(0.0, noise, image.shape), image.shape, noise)
    search = asked_for(asked, SCENE)
    models = Models(many_turns, lambda _: (many_turns, many_turns), family=search.family)
    return fit_models(seen, SCENE, Scaling(1.0, 0.0), models, lambda _: None, asked=search)


def off_in_sd(found: Estimate, phase: PhaseFunction) -> Array:
    truth = np.array([0.001, 0.02, phase.mean_cosine])
    return (np.array(found.medium.coefficients) - truth) / np.sqrt(np.diag(found.covariance))
