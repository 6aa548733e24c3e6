"""A graph in TOML: what it means, and one line for each wrong entry, through both commands."""

from pathlib import Path

import pytest

from hapnet import cli
from hapnet.ext.many.graph import read_graph
from hapnet.ext.many.summary import graph_verdict
from tests.conftest import ROOT
from tests.support.commands import Capture, empty_directory as empty_directory
from tests.support.processes import without_progress
from tests.support.wrong_graphs import BAD, GOOD, LEADS, LED, SHARED, changed

NEEDS = {"mujoco": "mujoco", "soft": "scipy"}


@pytest.mark.parametrize("command", [("simulate", "--no-files", "--graph"), ("graph", "check")])
@pytest.mark.parametrize("wrong", BAD)
def test_a_wrong_entry_is_answered_in_one_line(
    wrong: str, command: tuple[str, ...], empty_directory: Path, capsys: Capture
) -> None:
    if (needed := NEEDS.get(wrong.partition(":")[0])) is not None:
        pytest.importorskip(needed)
    text, says = BAD[wrong]
    (empty_directory / "examples").symlink_to(ROOT / "examples")
    (empty_directory / "g.toml").write_text(text, "utf-8")
    _answers(capsys, [*command, "g.toml"], says)


def _answers(capsys: Capture, argv: list[str], says: list[str]) -> None:
    assert cli.main(argv) == 2
    out, said = capsys.readouterr()
    line = without_progress(said)
    assert line.startswith("hapnet: ")
    assert line.count("\n") == 1
    assert not [words for words in says if words not in line], line
    assert "PASSIVE" not in out


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["simulate", "--graph", "folder", "--no-files"], ["folder", "a TOML file", "directory"]),
        (["graph", "check", "folder"], ["folder", "a TOML file", "directory"]),
        (["graph", "check", "nothing.toml"], ["nothing.toml", "a TOML file", "No such file"]),
        (["simulate", "--graph", "picture.toml"], ["picture.toml", "a TOML file", "decode"]),
        (["simulate", "--graph", "good.toml", "--seeds", "0:2"], ["--seeds 0:2", "use --seed"]),
        (["simulate", "--graph", "good.toml", "--duration", "0"], ["--duration is 0.0", "above 0 in virtual time"]),
        (["simulate", "--graph", "good.toml", "--coupling", "pd"], ["coupling is 'pd'", "such as pspm"]),
        (["device", "--node", "alice"], ["--node alice", "give --graph FILE.toml too"]),
        (["world", "--seats", "2", "--node", "table"], ["--node table", "give --graph FILE.toml too"]),
        (["world", "--graph", "good.toml", "--seats", "2"], ["--seats 2", "leave --seats out"]),
        (["world", "--graph", "good.toml", "--name", "bob"], ["--name bob", "leave --name out"]),
        (["world", "--graph", "good.toml", "--show-params"], ["--show-params", "leave --graph and --seats out"]),
        (["world", "--seats", "2", "--out", "here", "--no-files"], ["--out here", "leave one of the two out"]),
        (["device", "--graph", "good.toml", "--node", "bob", "--role", "follower"], ["--role follower", "its kind"]),
        (["device", "--graph", "good.toml", "--node", "table"], ["--node is 'table'", "alice, bob"]),
        (["world", "--seats", "alice,bob:look"], ["--seats is 'alice,bob:look'", "alice,bob:watch"]),
        (["world", "--seats", "alice:watch,alice"], ["--seats is 'alice:watch,alice'", "different names"]),
        (["world", "--seats", "free,bob"], ["--seats is 'free,bob'", "different names"]),
        (["world", "--name", "free", "--no-files"], ["--name free", "give the world another"]),
        (["world", "--seats", "world,bob"], ["--seats is 'world,bob'", "names other than world"]),
        (["run", "--graph", "good.toml", "--log", "x.jsonl"], ["--log x.jsonl", "leave --log out"]),
        (["run", "--graph", "good.toml", "--show-params"], ["--show-params", "leave --graph out"]),
        (["simulate", "--graph", "good.toml", "--show-params"], ["--show-params", "leave --graph out"]),
        (
            ["world", "--seats", "2", "-m", "client", "-l", "tcp/127.0.0.1:0", "--no-files"],
            ["--listen", "leave -l out"],
        ),
        (["graph", "check"], ["FILE.toml"]),
        (["graph", "chek", "good.toml"], ["chek", "check"]),
    ],
)
def test_a_wrong_argument_is_answered_in_one_line(
    argv: list[str], says: list[str], empty_directory: Path, capsys: Capture
) -> None:
    (empty_directory / "folder").mkdir()
    (empty_directory / "picture.toml").write_bytes((ROOT / "examples" / "run.png").read_bytes()[:1000])
    (empty_directory / "good.toml").write_text(GOOD, "utf-8")
    _answers(capsys, argv, says)
    assert not (empty_directory / "runs").exists()


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["device", "--node", "bob"], ["--node is 'bob'", "a device of the graph: alice"]),
        (["world"], ["--node is None", "a world or a follower of the graph: bob, carl"]),
        (["device", "--node", "alice", "--operator", "mouse"], ["operator", "only hapnet play has a page"]),
        (["device", "--node", "alice", "--record", "a.mcap"], ["--record a.mcap", "use --out DIRECTORY"]),
        (["world", "--node", "carl", "--coupling", "pd"], ["coupling is 'pd'"]),
    ],
)
def test_a_node_with_several_edges_or_a_follower_is_refused_in_one_line(
    argv: list[str], says: list[str], empty_directory: Path, capsys: Capture
) -> None:
    (empty_directory / "led.toml").write_text(LED, "utf-8")
    _answers(capsys, [*argv, "--graph", "led.toml", "--no-files"], says)


def test_each_node_has_a_command_that_dials_those_whom_it_leads(empty_directory: Path, capsys: Capture) -> None:
    (empty_directory / "led.toml").write_text(LEADS, "utf-8")
    assert cli.main(["graph", "check", "led.toml"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for line in (
        "on this machine: hapnet simulate --graph led.toml, or hapnet run --graph led.toml",
        "alice: hapnet device --graph led.toml --node alice -e tcp/BOB:17447",
        "bob: hapnet world --graph led.toml --node bob -l tcp/0.0.0.0:17447 -e tcp/CARL:17447",
        "carl: hapnet world --graph led.toml --node carl -l tcp/0.0.0.0:17447",
    ):
        assert line in lines


def test_a_graph_that_is_right_is_simulated_and_described(empty_directory: Path, capsys: Capture) -> None:
    (empty_directory / "g.toml").write_text(GOOD, "utf-8")
    assert cli.main(["graph", "check", "g.toml"]) == 0
    out, _ = capsys.readouterr()
    assert "alice-table" in out
    assert "2 pairs in 1 world; together they may give out 300 mJ" in out
    assert cli.main(["simulate", "--graph", "g.toml", "--out", "here"]) == 0
    assert "PASSIVE: each of 2 pairs" in capsys.readouterr().out
    left = {file.name for file in (empty_directory / "here").iterdir()}
    assert left >= {"alice-table.mcap", "alice-table.png", "bob-table.mcap", "bob-table.png", "summary.json"}


def test_a_nodes_and_an_edges_parameters_go_before_those_for_all(tmp_path: Path) -> None:
    file = tmp_path / "g.toml"
    text = 'operator = "press"\ndevice.mass = 0.5\nlink.up = "4g"\n' + changed(
        '"device"', '"device"\ndevice.mass = 0.7'
    )
    file.write_text(text, "utf-8")
    graph = read_graph(file)
    alice, bob = (graph.pair(edge) for edge in graph.edges.values())
    assert (alice.device.mass, bob.device.mass) == (0.7, 0.5)
    assert (alice.operator, bob.operator) == ("press", "press")
    assert (alice.link.up, alice.link.down, bob.link.up) == ("lan", "lan", "4g")
    assert (alice.scene, alice.dof) == (SHARED, 3)
    assert graph.edges["alice-table"].at == (-0.06, 0.0, 0.0)
    assert [edge.name for edge in graph.edges_of("table")] == ["alice-table", "bob-table"]


def test_a_pair_without_an_account_leaves_the_verdict_open() -> None:
    passive = {"verdict": {"passive": True, "reason": "it is"}, "theorem": {"energy_out_J": 0.0, "bound_J": 0.15}}
    broken = {**passive, "verdict": {"passive": False, "reason": "too much"}}
    assert graph_verdict({"a-t": passive}, {})["passive"] is True
    for edges in ({}, {"a-t": passive}):
        found = graph_verdict(edges, {}, missing=["b-t"])
        assert found["passive"] is None
        assert "b-t" in found["reason"]
    assert graph_verdict({"a-t": broken}, {}, missing=["b-t"])["passive"] is False
