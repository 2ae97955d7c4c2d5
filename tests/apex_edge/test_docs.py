"""The docs are held to the code: every error has its page, every named file exists."""

import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import apex_edge
import calib
import firmware_bridge
import offline_train
from apex_edge.errors import ApexError

ROOT = Path(__file__).resolve().parents[2]
OWN = ("apex_edge", "firmware_bridge", "calib", "offline_train")
DOCS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def all_errors():
    for package in (apex_edge, firmware_bridge, calib, offline_train):
        for info in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            try:
                importlib.import_module(info.name)
            except ModuleNotFoundError as error:
                # the modules of the graph models are PyTorch's own, and define no error
                if error.name not in ("torch", "torch_geometric"):
                    raise
    found, queue = set(), [ApexError]
    while queue:
        kind = queue.pop()
        if kind.__module__.split(".")[0] in OWN:
            found.add(kind)
        queue.extend(kind.__subclasses__())
    return found


def sections():
    """Return the text below each ``## slug`` heading of docs/errors.md."""
    parts = re.split(r"^## (\S+)\n", (ROOT / "docs/errors.md").read_text(), flags=re.M)
    return dict(zip(parts[1::2], parts[2::2]))


def test_every_error_has_a_section_with_message_cause_and_cure():
    pages = sections()
    for kind in all_errors():
        assert kind.slug in pages, f"docs/errors.md has no section {kind.slug} for {kind.__name__}"
        for word in ("Message", "Cause", "Cure"):
            assert f"**{word}**" in pages[kind.slug], f"{kind.slug}: {word} is missing"


def test_every_section_belongs_to_an_error():
    assert set(sections()) <= {kind.slug for kind in all_errors()}


def test_no_two_errors_share_a_section():
    slugs = [kind.slug for kind in all_errors()]
    assert len(slugs) == len(set(slugs))


@pytest.mark.parametrize("page", DOCS, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_and_links_named_in_the_docs_exist(page):
    text = page.read_text(encoding="utf-8")
    # a table row that says "planned" names what is still to come
    text = "\n".join(line for line in text.splitlines() if "planned" not in line)
    named = set(
        re.findall(
            r"`((?:apex_edge|firmware_bridge|calib|offline_train|tests|docs|scripts)"
            r"/[\w./-]+)`",
            text,
        )
    )
    links = re.findall(r"\]\((?!https?:|#)([^)#\s]+)", text)
    missing = [name for name in named if not (ROOT / name).exists()]
    missing += [link for link in links if not (page.parent / link).exists()]
    assert not missing


def test_make_targets_named_in_the_docs_exist():
    targets = set(re.findall(r"^([a-z0-9-]+):", (ROOT / "Makefile").read_text(), flags=re.M))
    for page in DOCS:
        named = set(re.findall(r"`make ([a-z0-9-]+)", page.read_text(encoding="utf-8")))
        assert named <= targets, page
