"""Rates that a person may set are those that the drivers take."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.cavro.settings import CavroSettings
from drivers.new_era.settings import NewEraSettings
from drivers.rig import simulated_rig
from drivers.rig_doser.settings import SimulatedDoserSettings
from tankrig.errors import SceneError
from ui.window.pump_rate import at_rate, pump_rate

DOSERS = {
    "new-era": (NewEraSettings, {"port": "p", "diameter_mm": 10.0, "rate_ml_per_min": 2.0, "count_file": "c"}),
    "cavro": (CavroSettings, {"port": "p", "syringe_ul": 1000.0, "speed_ul_per_s": 20.0, "count_file": "c"}),
    "simulated-doser": (SimulatedDoserSettings, {"folder": "f", "steps_per_ul": 4.0}),
}


@given(driver=st.sampled_from(sorted(DOSERS)), share=st.floats(0.0, 1.0))
def test_any_rate_within_the_bounds_is_one_that_the_driver_takes(tmp_path_factory, driver, share):
    """A field that lets through what the pump refuses costs the rig a failed opening."""
    settings, table = DOSERS[driver]
    rig = replace(simulated_rig(tmp_path_factory.mktemp("rate")), doser={"driver": driver, **table})
    rate = pump_rate(rig.doser)
    wanted = rate.least_ul_per_s + share * (rate.most_ul_per_s - rate.least_ul_per_s)
    changed = at_rate(rig, wanted)
    settings(**{key: value for key, value in changed.doser.items() if key != "driver"})
    assert pump_rate(changed.doser).ul_per_s == pytest.approx(wanted)
    assert changed.pace.dose_ul_per_s == wanted
    assert at_rate(rig, rate.ul_per_s).doser == pytest.approx({**rig.doser, rate.key: rig.doser.get(rate.key, 2000.0)})


@pytest.mark.parametrize("driver", sorted(DOSERS))
def test_a_rate_beyond_the_bounds_is_refused_and_would_be_by_the_driver(tmp_path, driver):
    settings, table = DOSERS[driver]
    rig = replace(simulated_rig(tmp_path), doser={"driver": driver, **table})
    rate = pump_rate(rig.doser)
    for wanted in (0.0, -1.0, 1.01 * rate.most_ul_per_s, float("nan"), float("inf")):
        with pytest.raises(SceneError, match="cannot deliver"):
            at_rate(rig, wanted)
    if driver != "cavro":  # whose speed is checked against its syringe when the pump is opened
        with pytest.raises(ValidationError):
            settings(**{**table, rate.key: 1.01 * rate.most_ul_per_s * rate.per_ul_per_s})
    with pytest.raises(SceneError, match="not in the rig file"):
        at_rate(replace(rig, doser={"driver": "rig-doser", "steps_per_ul": 10.0}), 10.0)


@pytest.mark.parametrize("wrong", [-3, 0, "much", None, float("nan"), float("inf")])
def test_a_wrong_table_has_no_rate_to_set(wrong):
    """The driver says what is wrong with it; a field that offers 0.01 to -21845 µl/s says nothing."""
    assert pump_rate({"driver": "simulated-doser", "steps_per_ul": wrong}) is None
    assert pump_rate({"driver": "cavro", "speed_ul_per_s": 20.0, "syringe_ul": wrong}) is None
