import os
import signal
import subprocess
import sys
import types

import pytest

from apex_edge import __version__, cli, plugins
from apex_edge.errors import ArmError, ConfigError, PluginError


def make_verb(run):
    verb = types.SimpleNamespace(HELP="do a thing", EXAMPLE="apex thing --depth 3", run=run)

    def add_arguments(parser):
        parser.add_argument("--depth", type=int, default=0)

    verb.add_arguments = add_arguments
    return verb


@pytest.fixture
def verb(monkeypatch):
    """Return a function that puts a verb called ``thing`` in place."""

    def install(run):
        monkeypatch.setattr(plugins, "load", lambda kind, name: make_verb(run))

    return install


def raising(error):
    def run(args):
        raise error

    return run


def run_apex(*arguments, code=None):
    command = [sys.executable, *(["-c", code] if code else ["-m", "apex_edge.cli"]), *arguments]
    return subprocess.run(command, capture_output=True, timeout=60)


def test_version_is_the_package_version(capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(["--version"])
    assert stop.value.code == 0
    assert capsys.readouterr().out == f"apex {__version__}\n"


def test_help_lists_every_registered_verb(capsys):
    assert cli.main(["--help"]) == 0
    out = capsys.readouterr().out
    for name in plugins.names("verbs"):
        assert f"  {name} " in out


def test_every_built_in_verb_is_registered_and_described():
    assert set(cli.BUILT_IN) == set(plugins.names("verbs"))


@pytest.mark.parametrize("name", sorted(cli.BUILT_IN))
def test_every_built_in_verb_has_help_with_an_example(name, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main([name, "--help"])
    assert stop.value.code == 0
    assert "example:\n  apex " + name in capsys.readouterr().out


def test_no_verb_shows_the_overview_and_fails(capsys):
    assert cli.main([]) == 2
    assert "apex demo" in capsys.readouterr().out


def test_unknown_option_is_named(capsys):
    assert cli.main(["--colour"]) == 2
    assert "--colour" in capsys.readouterr().err


def test_misspelt_verb_names_the_nearest_one_and_the_docs(capsys):
    assert cli.main(["demmo"]) == 2
    err = capsys.readouterr().err
    assert "did you mean 'demo'" in err
    assert "docs/errors.md#plugin" in err


def test_verb_gets_its_own_options_and_its_code_is_the_exit_code(verb):
    seen = []

    def run(args):
        seen.append(args.depth)
        return 7

    verb(run)
    assert cli.main(["thing", "--depth", "3"]) == 7
    assert seen == [3]


@pytest.mark.parametrize("arguments", [["-vv", "thing"], ["thing", "-vv"]])
def test_common_options_count_before_and_after_the_verb(verb, arguments):
    seen = []
    verb(lambda args: seen.append(args.verbose) or 0)
    assert cli.main(arguments) == 0
    assert seen == [2]


def test_typed_error_is_one_plain_line_with_its_docs(verb, capsys):
    verb(raising(ConfigError("apex.toml [agent]: unknown key 'top'")))
    assert cli.main(["thing"]) == 2
    err = capsys.readouterr().err
    assert err == ("apex: apex.toml [agent]: unknown key 'top'\n  see docs/errors.md#config\n")


def test_debug_shows_the_traceback_of_a_typed_error(verb):
    verb(raising(ArmError("port gone")))
    with pytest.raises(ArmError):
        cli.main(["thing", "--debug"])


def test_os_error_is_one_plain_line(verb, capsys):
    verb(raising(PermissionError(13, "Permission denied", "/root/out")))
    assert cli.main(["thing"]) == 2
    assert capsys.readouterr().err == "apex: [Errno 13] Permission denied: '/root/out'\n"


def test_a_bug_is_not_hidden(verb):
    verb(raising(ZeroDivisionError("bug")))
    with pytest.raises(ZeroDivisionError):
        cli.main(["thing"])


def test_missing_extra_says_what_to_install(verb, capsys):
    verb(raising(ModuleNotFoundError("No module named 'sklearn'", name="sklearn.linear_model")))
    assert cli.main(["thing"]) == 2
    assert "pip install 'apex-edge[train]'" in capsys.readouterr().err


def test_verb_that_cannot_be_imported_for_want_of_an_extra_says_what_to_install(
    monkeypatch, capsys
):
    def load(kind, name):
        cause = ModuleNotFoundError("No module named 'mujoco'", name="mujoco")
        raise PluginError("verbs plug-in 'thing' cannot be loaded") from cause

    monkeypatch.setattr(plugins, "load", load)
    assert cli.main(["thing"]) == 2
    assert "pip install 'apex-edge[offline]'" in capsys.readouterr().err


def test_incomplete_plug_in_is_refused_by_name(monkeypatch, capsys):
    monkeypatch.setattr(plugins, "load", lambda kind, name: types.SimpleNamespace(HELP="x"))
    assert cli.main(["thing"]) == 2
    assert "EXAMPLE, add_arguments, run" in capsys.readouterr().err


def test_broken_third_party_verb_does_not_break_help(monkeypatch, capsys):
    monkeypatch.setattr(plugins, "names", lambda kind: ["broken", "demo"])

    def load(kind, name):
        raise PluginError("no module named nonsense")

    monkeypatch.setattr(plugins, "load", load)
    assert cli.main(["--help"]) == 0
    assert "broken     (not usable: no module named nonsense)" in capsys.readouterr().out


def test_ctrl_c_ends_with_130(verb, capsys):
    verb(raising(KeyboardInterrupt()))
    assert cli.main(["thing"]) == 130
    assert "interrupted" in capsys.readouterr().err


def test_sigterm_unwinds_so_that_the_arm_is_stopped(verb):
    log = []

    def run(args):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            return 0
        finally:
            log.append("stopped")

    verb(run)
    with pytest.raises(SystemExit) as stop:
        cli.main(["thing"])
    assert stop.value.code == 128 + signal.SIGTERM
    assert log == ["stopped"]
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_wrong_option_of_a_verb_ends_with_2(verb):
    verb(lambda args: 0)
    with pytest.raises(SystemExit) as stop:
        cli.main(["thing", "--depth", "deep"])
    assert stop.value.code == 2


@pytest.mark.parametrize("option", ["--help", "--version"])
def test_help_and_version_import_no_heavy_package(option):
    code = (
        "import sys\n"
        "from apex_edge.cli import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'cv2', 'requests', 'serial', 'mcap', 'cattrs'} & set(sys.modules)\n"
        "sys.exit('imported ' + ', '.join(sorted(heavy)) if heavy else 0)\n"
    )
    done = run_apex(option, code=code)
    assert done.returncode == 0, done.stderr.decode()
    assert b"apex" in done.stdout


def test_reader_that_leaves_early_ends_the_command_quietly():
    pipe = f"'{sys.executable}' -m apex_edge.cli --help | true"
    done = subprocess.run(["sh", "-c", pipe], stderr=subprocess.PIPE, timeout=60)
    assert done.stderr == b""
