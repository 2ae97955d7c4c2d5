import math
from dataclasses import dataclass, field, fields
from typing import Optional, Tuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from apex_edge.config import read_toml, setting, structure
from apex_edge.errors import ConfigError


@dataclass(frozen=True)
class Lens:
    focal_px: float = setting(560.0, "focal length (px)", 1.0, 1e5)


@dataclass(frozen=True)
class Sample:
    window: int = setting(5, "frames", 2, 50)
    gain: float = setting(0.5, "no unit", 0.0, 1.0)
    mode: str = setting("fast", "how", choices=("fast", "slow"))
    is_on: bool = setting(True, "switch")
    names: Tuple[str, ...] = setting(("red",), "objects")
    pair_m: Tuple[float, float] = setting((0.1, 0.2), "metres", 0.0, 1.0)
    note: Optional[str] = setting(None, "free text")
    free: float = setting(0.0, "no range")
    lens: Lens = field(default_factory=Lens)


@dataclass(frozen=True)
class NeedsPort:
    port: str


def build(**values):
    return structure(Sample, values, "apex.toml [sample]")


def test_empty_section_gives_the_defaults():
    assert build() == Sample()


def test_values_are_taken_over():
    built = build(window=7, gain=0.25, mode="slow", is_on=False, names=["a", "b"], note="x")
    assert (built.window, built.gain, built.mode, built.is_on) == (7, 0.25, "slow", False)
    assert built.names == ("a", "b")
    assert built.note == "x"


def test_whole_number_is_a_fine_float_and_becomes_one():
    built = build(gain=1)
    assert isinstance(built.gain, float)
    assert built.gain == 1.0


def test_unknown_key_names_file_section_and_nearest_key():
    with pytest.raises(ConfigError, match=r"apex.toml \[sample\]: unknown key 'windw'.*'window'"):
        build(windw=5)


def test_unknown_key_far_from_all_lists_the_known_ones():
    with pytest.raises(ConfigError, match="known: free, gain, is_on"):
        build(zzzzz=5)


def test_unknown_key_in_a_nested_section_names_that_section():
    with pytest.raises(ConfigError, match=r"\[sample\]\.lens: unknown key 'focal'.*'focal_px'"):
        build(lens={"focal": 3.0})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("window", "5"),
        ("window", 5.0),
        ("window", True),
        ("window", [5]),
        ("gain", "0.5"),
        ("gain", True),
        ("mode", 3),
        ("is_on", 1),
        ("is_on", "true"),
        ("names", "red"),
        ("names", ["red", 3]),
        ("pair_m", [0.1]),
        ("pair_m", [0.1, 0.2, 0.3]),
        ("pair_m", [0.1, "0.2"]),
        ("note", 3),
        ("lens", 3),
        ("lens", None),
    ],
)
def test_wrong_type_is_refused_and_named(key, value):
    with pytest.raises(ConfigError, match=key):
        build(**{key: value})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("window", 1),
        ("window", 51),
        ("gain", -0.001),
        ("gain", 1.001),
        ("gain", math.nan),
        ("gain", math.inf),
        ("free", math.nan),
        ("pair_m", [0.5, 1.5]),
        ("pair_m", [math.nan, 0.5]),
    ],
)
def test_value_out_of_range_is_refused_and_named(key, value):
    with pytest.raises(ConfigError, match=key):
        build(**{key: value})


@pytest.mark.parametrize("value", [2, 50])
def test_both_ends_of_a_range_are_allowed(value):
    assert build(window=value).window == value


def test_wrong_choice_names_the_nearest():
    with pytest.raises(ConfigError, match="not one of fast, slow; did you mean 'slow'"):
        build(mode="slwo")


def test_key_without_default_must_be_given():
    with pytest.raises(ConfigError, match="key 'port' is missing"):
        structure(NeedsPort, {}, "x")


@given(st.dictionaries(st.text(max_size=8), st.one_of(st.integers(), st.floats(), st.text())))
def test_anything_is_either_built_in_range_or_refused_as_config_error(values):
    try:
        built = build(**values)
    except ConfigError:
        return
    assert 2 <= built.window <= 50
    assert 0.0 <= built.gain <= 1.0
    assert not math.isnan(built.free)
    assert set(values) <= {known.name for known in fields(Sample)}


def test_file_that_is_missing_is_named(tmp_path):
    with pytest.raises(ConfigError, match="nowhere.toml"):
        read_toml(tmp_path / "nowhere.toml")


def test_file_that_is_not_toml_is_named_with_the_line(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text("[agent]\ntop_k = = 3\n")
    with pytest.raises(ConfigError, match=r"bad.toml: not valid TOML.*line 2"):
        read_toml(path)


def test_file_that_is_not_text_is_refused(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="bad.toml"):
        read_toml(path)


def test_file_is_read_into_plain_values(tmp_path):
    path = tmp_path / "good.toml"
    path.write_text("[sample]\nwindow = 9\n[sample.lens]\nfocal_px = 300\n")
    built = structure(Sample, read_toml(path)["sample"], "good.toml [sample]")
    assert built.window == 9
    assert built.lens.focal_px == 300.0
