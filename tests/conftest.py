"""Shared set-up: deterministic property tests, and the folder of real recordings."""

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "apex",
    derandomize=True,
    deadline=None,  # no test fails on an absolute time
    database=None,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("apex")


@pytest.fixture(scope="session")
def real_data():
    """Return the folder of real recordings named by APEX_TEST_DATA, or skip."""
    named = os.environ.get("APEX_TEST_DATA", "")
    if not named:
        pytest.skip("APEX_TEST_DATA is not set: no real recordings here")
    folder = Path(named)
    assert folder.is_dir(), f"APEX_TEST_DATA={named} is not a folder"
    return folder
