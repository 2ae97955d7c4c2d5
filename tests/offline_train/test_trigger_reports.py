import argparse
import copy
import json
import re

import numpy as np
import pytest

from apex_edge.errors import InputError
from apex_edge.triggers import weights
from apex_edge.triggers.base import TriggerConfig
from offline_train import extras, verb
from offline_train.extras import MissingExtraError
from offline_train.reports import card, curves, evaluation, recipe, tables
from offline_train.scenes import tabletop_pairs
from offline_train.trigger import evaluate, observe, seeds

pytest.importorskip("matplotlib")
pytest.importorskip("sklearn")


@pytest.fixture(scope="module")
def fields():
    return json.loads(weights.SHIPPED.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def models(fields):
    model = weights.check(fields, "shipped")
    return {"shipped": evaluation.Model(fields, lambda seen: model.logit(seen.features))}


@pytest.fixture(scope="module")
def data():
    seen = observe.observe(
        seeds.rng("test", 11), tabletop_pairs.NAME, 200, observe.Watching(), TriggerConfig()
    )
    return evaluation.Data("pairs", seen, tabletop_pairs.KINDS)


@pytest.fixture(scope="module")
def tested(data, models):
    return evaluation.examine(data, models, lambda seen: seen.features)


@pytest.fixture(scope="module")
def files(fields, tested):
    return card.card(fields, "trigger-linear", [tested])


def test_a_card_says_what_its_headings_promise(files, fields):
    text = files["trigger-linear.md"]
    for wanted in (
        "How it was trained",
        "What is certified",
        "Figures on `pairs`",
        "Where it holds",
        "Cost",
        "Caveats",
        "Licence",
        fields["sha256"],
        fields["provenance"]["generator"],
        f"{fields['threshold']['n_pos']} scores",
        "99.0 % of events 1.0 s or more before contact",
        "persist_hits = 3",
        "fallback",
        "13 parameters",
    ):
        assert wanted in text, wanted
    for rule in ("shipped", *evaluate.BASELINES):
        assert re.search(rf"^\| {rule} \|", text, re.MULTILINE)
    assert "None" not in text and "nan" not in text


def test_every_picture_of_a_card_is_beside_it_and_shown(files):
    shown = set(re.findall(r"!\[[^]]+\]\(([^)]+)\)", files["trigger-linear.md"]))
    assert shown == set(files) - {"trigger-linear.md"}
    assert len(shown) == len(curves.NAMES)
    for name in shown:
        assert files[name].startswith("<?xml") and files[name].rstrip().endswith("</svg>")


def test_the_same_figures_give_the_same_bytes(files, fields, data, models):
    again = evaluation.examine(data, models, lambda seen: seen.features)
    assert card.card(fields, "trigger-linear", [again]) == files
    whole = "".join(files.values())
    assert "dc:date" not in whole and "matplotlib.org" not in whole.split("<defs>")[0]


def test_a_command_in_the_provenance_is_quoted_whole(fields, tested):
    named = copy.deepcopy(fields)
    named["provenance"]["command"] = "apex train trigger --seed 1 --out x.json"
    text = card.card(named, "x", [tested])["x.md"]
    assert "```\napex train trigger --seed 1 --out x.json\n```" in text


def test_the_commands_of_a_model_can_be_read_off_what_it_records(fields):
    fitted = copy.deepcopy(fields)
    drawn = {"scenario": "committed", "n_scenes": 300, "seed": 5}
    fitted["provenance"] = {
        "data": drawn,
        "model": "linear12",
        "label": "truth",
        "seed": 2,
        "certified_on": dict(drawn, kind="generated", n_scenes=900, only_contacts=True),
    }
    watching = "--noise-mm 0.5:3 --fps 20:30 --window 5:20 --horizon 5"
    assert recipe.commands(fitted) == [
        "apex train generate --scenario committed --scenes 300 --seed 5 --purpose train "
        f"{watching} --out train",
        "apex train fit --model linear12 --data train --label truth --seed 2 --out fitted.json",
        "apex train generate --scenario committed --scenes 900 --seed 5 --purpose calibration "
        f"{watching} --only-contacts --out calibration",
        "apex train calibrate --model fitted.json --data calibration --alpha 0.01 "
        "--confidence 0.95 --lead 1 --out certified.json",
    ]
    for line in recipe.commands(fitted):
        parser = argparse.ArgumentParser()
        verb.add_arguments(parser)
        parser.parse_args(line.split()[2:])
    fitted["provenance"].update(teacher_sha256="ab", mix_truth=0.5)
    assert recipe.commands(fitted)[1] == (
        "apex train distill --teacher TEACHER --student linear12 --mix-truth 0.5 --data train "
        "--label truth --seed 2 --out fitted.json"
    )
    wide = dict(fitted, feature_set="wide")
    assert " --horizon 5 --wide --out train" in recipe.commands(wide)[0]
    assert recipe.commands(dict(fields, provenance={"generator": "paper-star"})) == []
    drawn["n_rollouts"] = 32
    soft, _, plain, _ = recipe.commands(fitted)
    assert " --horizon 5 --soft 32 --out train" in soft and "--soft" not in plain


def test_the_card_says_how_many_files_may_fall_short_at_its_own_confidence(fields, tested):
    for confidence, text in ((0.95, "of 20 such files"), (0.99, "of 100 such files")):
        sure = dict(fields, threshold=dict(fields["threshold"], confidence=confidence))
        assert text in card.card(sure, "x", [tested])["x.md"]


def test_a_file_without_a_threshold_is_said_to_promise_nothing(fields, tested):
    text = card.card(dict(fields, threshold=None), "x", [tested])["x.md"]
    assert "no threshold has been chosen" in text and "confidence the model" not in text


def test_the_table_has_the_figures_of_the_evaluation(tested):
    table = tables.of_rules(tested.evaluation)
    ours = tested.evaluation["rules"]["shipped"]
    row = next(line for line in table.splitlines() if line.startswith("| shipped"))
    assert tables.share(ours["recall"]) in row
    assert f"| {ours['pr_auc']:.3g} |" in row and f"| {ours['ece']:.3g} |" in row
    speed = next(line for line in table.splitlines() if line.startswith("| speed only"))
    assert speed.count("| - ") == 4  # it states no probability and has no domain
    kinds = tested.evaluation["rules"]["shipped"]["by_kind"]
    assert all(
        f"n = {count['n']}" in tables.of_kinds(tested.evaluation) for count in kinds.values()
    )


def test_every_rule_keeps_its_look_whatever_stands_beside_it():
    alone = curves.styles_of(["a", *evaluate.BASELINES])
    both = curves.styles_of(["a", "b", *evaluate.BASELINES])
    assert all(alone[name] == both[name] for name in evaluate.BASELINES)
    assert len({style.colour for style in both.values()}) == len(both)
    assert len({style.marker for style in both.values()}) == len(both)


def test_a_report_over_two_models_has_a_row_and_a_curve_for_each(data, models, fields, tmp_path):
    low = copy.deepcopy(fields)
    low["threshold"]["logit"] = -5.0
    both = {**models, "anxious": evaluation.Model(low, models["shipped"].score)}
    tested = evaluation.examine(data, both, lambda seen: seen.features)
    rules = tested.evaluation["rules"]
    assert list(rules) == ["shipped", "anxious", *evaluate.BASELINES]
    assert rules["anxious"]["negative_frames"] > rules["shipped"]["negative_frames"]
    assert rules["anxious"]["pr_auc"] == rules["shipped"]["pr_auc"]
    found = evaluation.report([tested], both)
    card.write(found, tmp_path / "new" / "folder")
    kept = json.loads((tmp_path / "new" / "folder" / "evaluation.json").read_text())
    assert set(kept["models"]) == {"shipped", "anxious"}
    assert set(kept["sets"]["pairs"]["curves"]) == set(rules)
    assert kept["sets"]["pairs"]["rules"]["shipped"]["leads"]["lead_s"] == list(evaluate.LEADS_S)
    assert found == evaluation.report([tested], both)


def test_models_certified_under_different_gates_are_not_compared(models, fields):
    other = copy.deepcopy(fields)
    other["gate"]["persist_hits"] = 1
    both = {**models, "other": evaluation.Model(other, models["shipped"].score)}
    with pytest.raises(InputError, match="other was certified under"):
        evaluation.terms(both)


def test_where_the_rule_speaks_for_a_model_its_probability_counts(data, fields):
    rule = data.seen.rule_hit
    alone = evaluation.Model(fields, lambda seen: np.where(rule, 1e6, -1e6))
    tested = evaluation.examine(data, {"alone": alone}, lambda seen: seen.features)
    ours, analytic = (tested.evaluation["rules"][name] for name in ("alone", evaluate.ANALYTIC))
    assert ours["fallback_share"] == 1.0
    assert ours["brier"] == analytic["brier"]
    assert "fallback_share" not in analytic


def test_a_set_in_which_nothing_moves_is_refused(models, data):
    empty = observe.observe(
        seeds.rng("test", 1),
        tabletop_pairs.NAME,
        1,
        observe.Watching(n_frames=3),
        TriggerConfig(),
    )
    with pytest.raises(InputError, match="still.*nothing to test on"):
        evaluation.examine(data._replace(name="still", seen=empty), models, lambda s: s.features)


def test_without_matplotlib_it_says_what_to_install(monkeypatch, tested):
    def missing(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(extras.importlib, "import_module", missing)
    with pytest.raises(MissingExtraError, match=r"pip install 'apex-edge\[train\]'"):
        curves.draw(tested.evaluation, tested.points)
