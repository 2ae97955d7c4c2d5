import importlib_metadata
import pytest

from apex_edge import plugins
from apex_edge.errors import PluginError


@pytest.fixture
def published(monkeypatch):
    """Return a function that publishes entry points in place of the installed ones."""

    def publish(**values):
        group = "apex_edge.cameras"
        entries = [
            importlib_metadata.EntryPoint(name, value, group) for name, value in values.items()
        ]

        def entry_points(group):
            return [entry for entry in entries if entry.group == group]

        monkeypatch.setattr(importlib_metadata, "entry_points", entry_points)

    return publish


def test_names_are_sorted_and_unique(published):
    published(zed="apex_edge.types:Frame", able="apex_edge.types:Frame")
    assert plugins.names("cameras") == ["able", "zed"]


def test_kind_nobody_registers_has_no_names():
    assert plugins.names("teapots") == []


def test_load_returns_the_published_object(published):
    from apex_edge.types import Frame

    published(fake="apex_edge.types:Frame")
    assert plugins.load("cameras", "fake") is Frame


def test_unknown_name_suggests_the_nearest(published):
    published(folder="apex_edge.types:Frame", video="apex_edge.types:Frame")
    with pytest.raises(PluginError, match="did you mean 'video'"):
        plugins.load("cameras", "vidoe")


def test_unknown_name_far_from_all_lists_what_there_is(published):
    published(folder="apex_edge.types:Frame", video="apex_edge.types:Frame")
    with pytest.raises(PluginError, match="known: folder, video"):
        plugins.load("cameras", "q")


def test_plug_in_whose_module_is_missing_keeps_the_cause(published):
    published(ghost="no_such_module_at_all:Camera")
    with pytest.raises(PluginError, match="'ghost' cannot be loaded") as caught:
        plugins.load("cameras", "ghost")
    assert isinstance(caught.value.__cause__, ImportError)
    assert caught.value.__cause__.name == "no_such_module_at_all"


def test_plug_in_whose_class_is_missing_is_refused(published):
    published(ghost="apex_edge.types:NoSuchThing")
    with pytest.raises(PluginError, match="NoSuchThing"):
        plugins.load("cameras", "ghost")


@pytest.mark.parametrize(
    "kind", ["cameras", "triggers", "simulators", "planners", "verbs", "benches"]
)
def test_every_built_in_part_can_be_loaded(kind):
    names = plugins.names(kind)
    assert names
    for name in names:
        assert plugins.load(kind, name) is not None
