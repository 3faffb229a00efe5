"""What every test shares: a cache folder of the session's own, so that none finds or leaves models on the computer."""

import os

import pytest


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        if not os.environ.get("TANKRIG_CACHE"):
            patch.setenv("TANKRIG_CACHE", str(tmp_path_factory.getbasetemp().parent / "tankrig-cache"))
        yield
