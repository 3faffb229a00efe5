"""Pictures of fits: they show what they claim to, whatever the model, and appear whole or not at all."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tankrig.errors import StoreError
from tankrig.estimation.estimate import Estimate
from tankrig.estimation.result import by_order
from tankrig.figures.fit_figure import write_fit_figure
from tankrig.figures.paper import collimated_cases, observed, paper_figures
from tankrig.figures.tank_image import FALSE_COLOUR, brightness
from tankrig.image.prediction_file import ARRAY_NAMES
from tankrig.prediction import Prediction
from tankrig.scene import load_scene

from .seen_pictures import likeness, words_in

REFERENCE = Path(__file__).parent / "data" / "reference"


def reference(name: str) -> tuple[Estimate, Prediction]:
    """A reference image with its orders, and the perfect fit of it with noise."""
    with np.load(REFERENCE / f"{name}.npz") as arrays:
        orders = {order: arrays[key].astype(float) for order, key in ARRAY_NAMES.items()}
    image = np.sum(list(orders.values()), axis=0)
    scene = load_scene(REFERENCE / f"{name}.toml")
    noise = 0.002 * float(image.max())
    residual = np.random.default_rng(3).normal(0.0, noise, image.shape)
    fit = Estimate(
        medium=scene.medium, covariance=np.diag([1e-10, 1e-8, 1e-6]), identifiable={}, gain=1.0, offset=0.0,
        image=image, residual=residual, rmse=noise, verdict="σa, σs and g are all determined.", model="tank",
        noise=noise, model_error=0.003,
    )  # fmt: skip
    return fit, Prediction(image, "tank", orders)


@pytest.mark.parametrize("name", ["pub08", "pub04"], ids=["thin", "dense"])
def test_more_orders_rebuild_the_image_better(name: str) -> None:
    """The paper's result; an order counted twice or left out would break the fall of the RMSE to the noise."""
    fit, prediction = reference(name)
    rebuilt = by_order(fit, prediction)
    assert [one.orders for one in rebuilt] == ["1", "1–3", "1–20", "all"]
    errors = [one.rmse for one in rebuilt]
    assert errors[0] > 1.2 * errors[1]
    assert errors[1] > 1.05 * errors[2]
    assert errors[2] >= errors[3] == pytest.approx(fit.noise, rel=0.05)


def test_gain_and_offset_stay_the_same_for_every_order() -> None:
    """Fitting them anew for each would hide the missing light of the low orders."""
    fit, prediction = reference("pub08")
    counts = replace(fit, gain=3e7, offset=50.0, image=3e7 * fit.image + 50.0, residual=3e7 * fit.residual)
    for one, scaled in zip(by_order(fit, prediction), by_order(counts, prediction), strict=True):
        assert scaled.rmse == pytest.approx(3e7 * one.rmse, rel=1e-6)


@pytest.mark.parametrize(
    ("orders", "compared"), [(True, True), (False, False)], ids=["tank", "model without orders, nothing beside it"]
)
def test_the_picture_of_a_fit_is_drawn_for_every_model(tmp_path: Path, orders: bool, compared: bool) -> None:
    """A model without orders, or single scattering itself, must not end in a traceback after a long fit."""
    fit, prediction = reference("pub08")
    shown = prediction if orders else replace(prediction, orders={})
    photograph = fit.image + fit.residual
    fit.residual[:3, :5] = np.nan  # pixels that were left out
    scene, single = load_scene(REFERENCE / "pub08.toml"), fit if compared else None
    drawing, file = tmp_path / "new" / "fit.svg", tmp_path / "new" / "fit.png"
    for path in (drawing, file):
        write_fit_figure(path, scene, fit, by_order(fit, shown), single)
    words = words_in(drawing)
    assert {"Observed, in false colour", "tank model", "All orders: RMSE 0.2 %", "Observed − all orders"} <= set(words)
    assert [word.partition(":")[0] for word in words if "rder" in word and "RMSE" in word] == (
        ["Order 1", "Orders 1–3", "Orders 1–20", "All orders"] if orders else ["All orders"]
    )
    assert ("single-scattering fit" in words) == compared
    assert likeness(file, photograph, FALSE_COLOUR, brightness(photograph)) > 0.93
    assert likeness(file, photograph[:, ::-1], FALSE_COLOUR, brightness(photograph)) < 0.8, "light comes from the left"
    assert {path.name for path in file.parent.iterdir()} == {"fit.svg", "fit.png"}


@pytest.mark.parametrize(
    ("model", "max_order", "whole"),
    [("single", None, "Order 1 alone"), ("diffuse", None, "The diffuse limit"), ("tank", 3, "Orders 1–3")],
)
def test_an_image_is_called_by_the_light_that_its_model_has(
    tmp_path: Path, model: str, max_order: int | None, whole: str
) -> None:
    """Single scattering's own image was called "All orders", in a picture that was three quarters empty."""
    fit, prediction = reference("pub08")
    one, scene = replace(fit, model=model), load_scene(REFERENCE / "pub08.toml")
    drawing = tmp_path / "fit.svg"
    rebuilt = by_order(one, replace(prediction, orders={}))
    write_fit_figure(drawing, scene, one, rebuilt, None if model == "single" else fit, max_order)
    words = words_in(drawing)
    lower = whole[0].lower() + whole[1:]
    assert {f"{whole}: RMSE 0.2 %", f"Observed − {lower}", f"fit: {lower}"} <= set(words)
    assert not any("all orders" in word.lower() or word == "full fit" for word in words)
    assert ("single-scattering fit" in words) == (model != "single")


def test_a_picture_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    """Half a picture would be taken for a whole one."""
    fit, prediction = reference("pub08")
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StoreError, match="cannot be written"):
        write_fit_figure(
            tmp_path / "file" / "fit.png", load_scene(REFERENCE / "pub08.toml"), fit, by_order(fit, prediction), None
        )


def test_the_papers_figures_are_drawn(tmp_path: Path) -> None:
    """They are what the project shows of itself; drawn from the model at the reference's own medium."""
    thin = observed(REFERENCE / "pub08.npz")
    files = paper_figures(thin, thin, [reference("pub08")[0]] * 2, tmp_path)
    assert [file.name for file in files] == ["figure5.png", "figure6.png", "figure7.png"]
    scale = brightness(thin.image)
    assert all(likeness(file, thin.image, FALSE_COLOUR, scale) > 0.93 for file in files)


def test_reference_cases_are_told_apart_by_their_scenes() -> None:
    """The table of estimates promises every collimated case without a reflecting surface."""
    names = [case.stem for case in collimated_cases(REFERENCE)]
    assert names == ["pub01", "pub02", "pub03", "pub04", "pub05", "pub06", "pub07", "pub08", "pub13"]
