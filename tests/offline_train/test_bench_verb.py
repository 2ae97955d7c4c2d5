"""``apex bench`` finds benchmarks by name, as plug-ins."""

import argparse
import json
from types import SimpleNamespace

import pytest

from apex_edge import plugins
from apex_edge.errors import ConfigError, PluginError
from offline_train.benchmarks import lines, suites, verb


def parser():
    result = argparse.ArgumentParser(prog="apex bench")
    verb.add_arguments(result)
    return result


@pytest.fixture
def two_benches(monkeypatch):
    """One benchmark that works and one whose package is not installed."""
    seen = []
    good = SimpleNamespace(
        HELP="measure nothing",
        EXAMPLE="apex bench good",
        add_arguments=lambda p: p.add_argument("--times", type=int, default=1),
        run=lambda args: seen.append(args.times) or 7,
    )

    def load(kind, name):
        assert kind == "benches"
        if name == "good":
            return good
        raise PluginError(f"benches plug-in {name!r} cannot be loaded: No module named 'mujoco'")

    monkeypatch.setattr(plugins, "names", lambda kind: ["broken", "good"])
    monkeypatch.setattr(plugins, "load", load)
    return seen


def test_the_chosen_benchmark_runs_with_its_own_options_and_gives_the_exit_code(two_benches):
    args = parser().parse_args(["good", "--times", "3"])
    assert verb.run(args) == 7
    assert two_benches == [3]


def test_help_lists_a_benchmark_that_cannot_be_imported(two_benches, capsys):
    with pytest.raises(SystemExit) as stop:
        parser().parse_args(["--help"])
    assert stop.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "measure nothing" in text
    assert "not usable" in text
    assert "mujoco" in text


def test_asking_for_a_benchmark_that_cannot_be_imported_is_a_typed_error(two_benches):
    with pytest.raises(PluginError, match="mujoco"):
        verb.run(parser().parse_args(["broken"]))


@pytest.mark.parametrize("words", [[], ["no-such-bench"]])
def test_no_or_an_unknown_benchmark_is_a_wrong_command_line(words):
    with pytest.raises(SystemExit) as stop:
        parser().parse_args(words)
    assert stop.value.code == 2


def test_rollout_is_registered():
    assert parser().parse_args(["rollout", "--scenes", "5"]).scenes == 5


@pytest.mark.parametrize(("value", "code"), [(1.0, 0), (3.0, 1)])
def test_a_bench_of_suites_runs_the_chosen_ones_and_fails_on_a_miss(value, code, tmp_path, capsys):
    parser = argparse.ArgumentParser()
    suites.add_suite_arguments(parser, ("one", "two"))
    out = tmp_path / "lines.json"
    args = parser.parse_args(["--suite", "two", "--seed", "7", "--json", str(out)])
    asked = []

    def measure(name):
        asked.append(name)
        return [lines.at_most(name, "a figure", value, 2.0)]

    assert suites.run_suites(args, ("one", "two"), measure, {"format": "toy"}) == code
    written = json.loads(out.read_text(encoding="utf-8"))
    assert asked == ["two"] and "a figure" in capsys.readouterr().out
    assert (written["format"], written["seed"], written["is_ok"]) == ("toy", 7, code == 0)
    assert [line["measured"] for line in written["lines"]] == [f"{value:g}"]


def test_a_bench_refuses_a_seed_below_zero_and_a_folder_that_is_not_there(tmp_path):
    parser = argparse.ArgumentParser()
    suites.add_suite_arguments(parser, ("one",))
    for wrong in (["--seed", "-1"], ["--json", str(tmp_path / "no" / "f.json")]):
        with pytest.raises(ConfigError):
            suites.run_suites(parser.parse_args(wrong), ("one",), lambda name: [], {})
