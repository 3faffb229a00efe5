"""What every test shares: a cache folder of the session's own, so that none finds or leaves models on the computer.

All processes of a session use the same one, so that what one of them has prepared the others need not.
"""

import gc
import os
import sys

import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Give each process one BLAS thread, where tests run in several; they inherit this, and NumPy reads it.

    Threads that wait for their turn at a processor spin meanwhile: 28 instead of 1.6 CPU s for one test.

    Bytecode is kept whatever the environment says, beside the kernels that are kept anyway: tests start hundreds of
    processes, and each would compile all sources anew.
    """
    if config.getoption("numprocesses", None):
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
        sys.dont_write_bytecode = False


def pytest_collection_finish() -> None:
    """Leave what has been imported and collected out of every later search for garbage."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory):
    with pytest.MonkeyPatch.context() as patch:
        if not os.environ.get("TANKRIG_CACHE"):
            folder = tmp_path_factory.getbasetemp()
            session = folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder
            patch.setenv("TANKRIG_CACHE", str(session / "tankrig-cache"))
        yield


@pytest.fixture(autouse=True)
def _application(request: pytest.FixtureRequest) -> None:
    """Widgets want an application: without one Qt aborts the process, which happened to whoever was first in it."""
    if request.path.name.startswith("test_window"):
        from ui.window.app import application

        application()
