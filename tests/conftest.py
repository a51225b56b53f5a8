import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# The same examples on every run, and no verdict that depends on how busy the machine is.
settings.register_profile(
    "deterministic",
    derandomize=True,
    database=None,
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("deterministic")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Folder of the measured records, which are not copied into the project."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("SYSID_TRIB_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no measured records in {folder}; set SYSID_TRIB_DATA to their folder")
    return folder
