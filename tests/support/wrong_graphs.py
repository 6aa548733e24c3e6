"""Graphs that are wrong, each in one entry, with the words of the answer; and the right graphs that they come from."""

GOOD = """duration_s = 0.2
[nodes.table]
kind = "world"
scene = "shared:block?mass=0.2&at=0,0,0"
dof = 3
[nodes.alice]
kind = "device"
[nodes.bob]
kind = "device"
[[edges]]
from = "alice"
to = "table"
link = "lan"
at = [-0.06, 0, 0]
[[edges]]
from = "bob"
to = "table"
at = [0.06, 0, 0]
"""
NODES, _, _ = GOOD.partition("[[edges]]")
SHARED = "shared:block?mass=0.2&at=0,0,0"
NO_ROOM = "have room for several hands"
BOX = "mujoco:examples/graphs/carried_box.xml"
MANY = "".join(f'[nodes.n{k}]\nkind = "device"\n[[edges]]\nfrom = "n{k}"\nto = "table"\n' for k in range(63))


def changed(old: str, new: str, times: int = 1) -> str:
    assert GOOD.count(old) >= times
    return GOOD.replace(old, new, times)


def one_hand(scene: str, dof: int = 3) -> str:
    """Two devices in a scene that has room for one."""
    text = changed(SHARED, scene).replace("dof = 3", f"dof = {dof}")
    return text.replace("at = [-0.06, 0, 0]\n", "").replace("at = [0.06, 0, 0]\n", "")


LED = """duration_s = 0.2
scene = "free"
dof = 3
[nodes.alice]
kind = "device"
[nodes.bob]
kind = "follower"
[nodes.carl]
kind = "follower"
[[edges]]
from = "alice"
to = "bob"
[[edges]]
from = "alice"
to = "carl"
"""
LEADS = LED.replace('from = "alice"\nto = "carl"', 'from = "bob"\nto = "carl"')
HELD = LED.replace('"follower"', '"follower"\noperator = "rest"')


def led(old: str, new: str, text: str = LED) -> str:
    """The graph of a teacher with two followers, or of a chain, with the first `old` replaced by `new`."""
    assert old in text
    return text.replace(old, new, 1)


UNFELT = led('to = "bob"', 'to = "bob"\nforce = false')
BAD_LEADERS = {
    "shares above 1": (
        led('to = "bob"', 'to = "bob"\nshare = 0.7'),
        ["nodes.alice: the sum of its shares is 1.2", "add up to at most 1 (alice-bob 0.7, alice-carl 0.5"],
    ),
    "a share of 0": (led('to = "bob"', 'to = "bob"\nshare = 0'), ["edges[0].share is 0", "above 0, up to 1"]),
    "a share above 1": (led('to = "bob"', 'to = "bob"\nshare = 1.5'), ["edges[0].share is 1.5", "above 0, up to 1"]),
    "a share in words": (led('to = "bob"', 'to = "bob"\nshare = "half"'), ["edges[0].share is 'half'", "0.25"]),
    "true as a share": (led('to = "bob"', 'to = "bob"\nshare = true'), ["edges[0].share is True", "0.25"]),
    "nan as a share": (led('to = "bob"', 'to = "bob"\nshare = nan'), ["edges[0].share is nan", "0.25"]),
    "force in words": (led('to = "bob"', 'to = "bob"\nforce = "no"'), ["edges[0].force is 'no'", "true or false"]),
    "a wrong word of an edge": (led('to = "bob"', 'to = "bob"\nshares = 1'), ["edges[0] 'shares'", "mean share?"]),
    "a follower without a leader": (
        LED + '[nodes.dora]\nkind = "follower"\n',
        ["nodes.dora is 'a follower with 0 leaders and 0 edges'", "allowed: one leader"],
    ),
    "a follower with two leaders": (
        LED + '[[edges]]\nfrom = "bob"\nto = "carl"\n',
        ["nodes.carl is 'a follower with 2 leaders and 0 edges'", "allowed: one leader"],
    ),
    "a follower that leads itself": (led('from = "alice"', 'from = "bob"'), ["edges[0].to", "'bob'", "carl"]),
    "a cycle that no hand leads": (
        led('from = "alice"', 'from = "carl"', led('"alice"\nto = "carl"', '"bob"\nto = "carl"'))
        + '[nodes.dora]\nkind = "follower"\n[[edges]]\nfrom = "alice"\nto = "dora"\n',
        ["nodes.bob is 'in a cycle of followers: bob, carl'", "allowed: a hand that leads them"],
    ),
    "at of a follower": (led('to = "bob"', 'to = "bob"\nat = [0, 0, 0]'), ["edges[0].at [0, 0, 0]", "follower.start"]),
    "rights at a follower": (
        led('to = "bob"', 'to = "bob"\nrights = "watch"'),
        ["edges.alice-bob.rights is 'watch'", "left out"],
    ),
    "a world leads": (
        LED + '[nodes.table]\nkind = "world"\n[[edges]]\nfrom = "table"\nto = "bob"\n',
        ["edges[2].from is 'table'", "a device or a follower of [nodes]: alice, bob, carl"],
    ),
    "other axes": (
        led('[nodes.bob]\nkind = "follower"', '[nodes.bob]\nkind = "follower"\ndof = 2'),
        ["edges.alice-carl is '3 axes in m'", "allowed: 2 axes in m, as alice-bob has at alice"],
    ),
    "other units": (
        led('[nodes.bob]\nkind = "follower"', '[nodes.bob]\nkind = "follower"\nscene = "joints"'),
        ["edges.alice-carl is '3 axes in m'", "in rad, as alice-bob has at alice"],
    ),
    "other axes in a chain": (
        led('[nodes.bob]\nkind = "follower"', '[nodes.bob]\nkind = "follower"\ndof = 2', LEADS),
        ["edges.bob-carl is '3 axes in m'", "allowed: 2 axes in m, as alice-bob has at bob"],
    ),
    **{
        f"{law} with shares": (
            f'coupling = "{law}"\n' + LED,
            [f"coupling is '{law}'", "pspm or zoh where a node leads"],
        )
        for law in ("pd", "wave", "tdpa")
    },
    "a law that acts within the step of a leader": (
        'coupling = "wave"\n' + LEADS,
        ["edges.alice-bob: coupling is 'wave'", "pspm or zoh, with a held force, where the follower leads others"],
    ),
    "a law that acts within the step of a held follower": (
        'coupling = "wave"\n' + led('"follower"', '"follower"\noperator = "rest"'),
        ["edges.alice-bob: coupling is 'wave'", "where a hand holds the follower"],
    ),
    "a law without the account that an unfelt edge needs": (
        'coupling = "zoh"\n' + UNFELT,
        ["edges.alice-bob: coupling is 'zoh'", "pspm with force = false"],
    ),
    "a device of joints with shares": (
        led('kind = "device"', 'kind = "device"\nhardware = "omni"'),
        ["hardware is 'omni'", "allowed: simulated where a node leads with a share, as alice does"],
    ),
    "the range harvest with shares": (
        led('kind = "device"', 'kind = "device"\ndevice.harvest = "range"\ndevice.own_damping = 5.0'),
        ["device.harvest is 'range'", "allowed: measured where a node leads with a share"],
    ),
    "a tool with shares": (led('"free"', '"tool:box"').replace("dof = 3\n", ""), ["scene is 'tool:box'", "a tool"]),
    "a measured force without a spring": (
        'follower.feedback = "force"\n' + UNFELT,
        ["follower.feedback is 'force'", "allowed: position with force = false"],
    ),
    "a measured force of a hand": (
        'follower.feedback = "force"\n' + HELD,
        ["follower.feedback is 'force'", "a hand holds"],
    ),
    "a hand's impedance without a hand": (
        led('"follower"', '"follower"\noperator_model.mass = 0.1'),
        ["nodes.bob is 'operator_model.mass'", "left out without operator"],
    ),
    "a hand that is not there": (
        led('"follower"', '"follower"\noperator = "sein"'),
        ["nodes.bob: unknown operator 'sein'"],
    ),
    "a leader's mass": (
        led('"follower"', '"follower"\ndevice.mass = 0.1', LEADS),
        ["nodes.bob: device.mass 0.1", "a follower leads with its robot's own, follower.mass"],
    ),
    "key of a follower": (led('"follower"', '"follower"\nhardware = "omni"'), ["nodes.bob is 'hardware'", "follower:"]),
    "a robot that is not simulated": (
        led('"follower"', '"follower"\nfollower.robot = "franka:1"'),
        ["follower.robot", "simulated"],
    ),
}

BAD = {
    "empty": ("", ["nodes is None", "allowed: a table", "[nodes.alice]"]),
    "no nodes": ('[[edges]]\nfrom = "a"\nto = "b"\n', ["nodes is None", "allowed: a table"]),
    "nodes in a list": ('nodes = []\n[[edges]]\nfrom = "a"\nto = "b"\n', ["nodes is []", "allowed: a table"]),
    "a node that is no table": ("nodes.x = 5\n" + GOOD, ["nodes.x is 5", "allowed: a table"]),
    "no edges": (NODES, ["edges is None", "allowed: one or more tables [[edges]]"]),
    "empty edges": ("edges = []\n" + NODES, ["edges is []", "allowed: one or more tables [[edges]]"]),
    "edges in a table": (NODES + '[edges]\nfrom = "alice"\n', ["edges is {", "allowed: one or more tables [[edges]]"]),
    "an edge that is no table": ("edges = [1]\n" + NODES, ["edges[0] is 1", "[[edges]] with from and to"]),
    "kind": (changed('"device"', '"devise"'), ["nodes.alice.kind 'devise'", "did you mean device?"]),
    "kind in a list": (changed('"device"', '["device"]'), ["nodes.alice.kind ['device']", "device"]),
    "kind in a table": (
        changed('"device"', "{a = 1}"),
        ["nodes.alice.kind is {'a': 1}", "world or follower"],
    ),
    "no kind": (
        changed('kind = "device"', 'operator = "rest"'),
        ["nodes.alice.kind is None", "world or follower"],
    ),
    "a node's name": (
        GOOD.replace("nodes.alice", "nodes.Alice").replace('"alice"', '"Alice"'),
        ["nodes is 'Alice'", "allowed: names other than free of small letters"],
    ),
    "to": (changed('to = "table"', 'to = "tabel"'), ["edges[0].to 'tabel'", "did you mean table?"]),
    "from": (changed('from = "alice"', 'from = "alise"'), ["edges[0].from 'alise'", "did you mean alice?"]),
    "from a world": (changed('from = "alice"', 'from = "table"'), ["edges[0].from is 'table'", "alice, bob"]),
    "no from": (changed('from = "alice"\n', ""), ["edges[0].from is None", "allowed: a device", "alice, bob"]),
    "a node twice": (GOOD + '[nodes.alice]\nkind = "device"\n', ["Cannot declare", "alice", "twice", "line 19"]),
    "two edges between the same nodes": (
        GOOD + '[[edges]]\nfrom = "alice"\nto = "table"\nname = "more"\n',
        ["edges.more is 'another edge to table'", "allowed: one edge from alice to table"],
    ),
    "the same edge twice": (
        GOOD + '[[edges]]\nfrom = "alice"\nto = "table"\n',
        ["edges[2].name is 'alice-table'", "allowed: a name that no other edge has"],
    ),
    "a device without an edge": (GOOD + '[nodes.eve]\nkind = "device"\n', ["nodes.eve is '0 edges'", "1 to 64 edges"]),
    "a world without an edge": (GOOD + '[nodes.shelf]\nkind = "world"\n', ["nodes.shelf is '0 edges'", "1 to 64"]),
    "65 edges": (GOOD + MANY, ["nodes.table is '65 edges'", "allowed: 1 to 64 edges"]),
    "key of a device": (changed('"device"', '"device"\noperater = 1'), ["nodes.alice 'operater'", "mean operator?"]),
    "key of another kind": (
        changed('"device"', '"device"\nscene = "wall"'),
        ["nodes.alice is 'scene'", "allowed: a parameter of a device: operator"],
    ),
    "key below a device": (changed('"device"', '"device"\ndevice.masss = 1'), ["nodes.alice", "mean device.mass"]),
    "value of a device": (
        changed('"device"', '"device"\ndevice.mass = -1'),
        ["nodes.alice: device.mass is -1.0", "allowed: a number above 0"],
    ),
    "key of an edge": (changed('link = "lan"', 'lnk = "lan"'), ["edges[0] 'lnk'", "did you mean link?"]),
    "key below an edge": (changed('link = "lan"', 'link.upp = "lan"'), ["edges.alice-table", "did you mean link.up?"]),
    "key at the top": (changed("duration_s", "duraton_s"), ["'duraton_s'", "did you mean duration_s?"]),
    "link": (changed('"lan"', '"lann"'), ["edges.alice-table: link", "'lann'", "did you mean lan?"]),
    "link's value": (changed('"lan"', '"delay x"'), ["edges.alice-table: link: delay", "'x'", "allowed: "]),
    "link in a number": (changed('"lan"', "5"), ["edges.alice-table", "link.up"]),
    "length of at": (changed("[-0.06, 0, 0]", "[-0.06, 0]"), ["edges.alice-table.at is [-0.06, 0.0]", "3 lengths"]),
    "at in words": (changed("[-0.06, 0, 0]", '"left"'), ["edges[0].at is 'left'", "such as [0.1, 0, 0]"]),
    "words in at": (changed("[-0.06, 0, 0]", '["a", 0, 0]'), ["edges[0].at is ['a', 0, 0]", "such as [0.1, 0, 0]"]),
    "no number in at": (changed("[-0.06, 0, 0]", "[nan, 0, 0]"), ["edges[0].at is [nan, 0, 0]", "allowed: a list"]),
    "true in at": (changed("[-0.06, 0, 0]", "[true, 0, 0]"), ["edges[0].at is [True, 0, 0]", "allowed: a list"]),
    "far away": (changed("[-0.06, 0, 0]", "[1e300, 0, 0]"), ["edges[0].at is [1e+300, 0, 0]", "up to 1000 m"]),
    "inside the block": (
        changed("[-0.06, 0, 0]", "[0, 0, 0]"),
        ["edges.alice-table.at", "is (0.0, 0.0, 0.0)", "allowed: a place outside the blocks"],
    ),
    "inside by default": (changed("at = [-0.06, 0, 0]\n", ""), ["edges.alice-table.at", "a place outside the blocks"]),
    "soft": (one_hand("soft:organ?nodes=300"), ["nodes.table", "'2 edges'", NO_ROOM]),
    "mujoco: more hands than proxies": (
        one_hand(f"{BOX}?proxy=left"),
        ["nodes.table: scene mujoco is '2 edges'", "allowed: up to 1, one for each proxy of the scene: left"],
    ),
    "mujoco: the same proxy twice": (
        one_hand(BOX).replace('to = "table"', 'to = "table"\nproxy = "left"'),
        ["edges.bob-table.proxy is 'left'", "no other hand holds", "alice-table holds it"],
    ),
    "mujoco: the same proxy twice in the scene": (
        one_hand(f"{BOX}?proxy=left,left"),
        ["scene", "?proxy=left,left", "different names"],
    ),
    "mujoco: an unknown proxy": (
        one_hand(BOX).replace('to = "table"', 'to = "table"\nproxy = "lift"', 1),
        ["edges.alice-table.proxy 'lift'", "did you mean left?"],
    ),
    "mujoco: a proxy far from any name": (
        one_hand(BOX).replace('to = "table"', 'to = "table"\nproxy = "zzz"', 1),
        ["edges.alice-table.proxy is 'zzz'", "allowed: a body or site of the model: box, left, right"],
    ),
    "mujoco: a proxy that the scene does not name": (
        one_hand(f"{BOX}?proxy=left,right").replace('to = "table"', 'to = "table"\nproxy = "box"', 1),
        ["edges.alice-table.proxy is 'box'", "one of the scene's proxies: left, right"],
    ),
    "mujoco: a place of a named proxy": (
        changed(SHARED, f"{BOX}?proxy=left,right"),
        ["edges.alice-table.at [-0.06, 0.0, 0.0]: ", "leave `at` out"],
    ),
    "mujoco: axes of at": (
        changed(SHARED, BOX).replace("dof = 3", "dof = 2"),
        ["edges.alice-table.at is [-0.06, 0.0, 0.0]", "2 lengths"],
    ),
    "mujoco: rights": (
        one_hand(f"{BOX}?proxy=left,right").replace('to = "table"', 'to = "table"\nrights = "watch"', 1),
        ["edges.alice-table.rights is 'watch'", "left out", "a hand holds its proxy"],
    ),
    "proxy among blocks": (
        changed('link = "lan"', 'proxy = "left"'),
        ["edges.alice-table.proxy left: ", "is no MuJoCo model"],
    ),
    "proxy in a list": (changed('link = "lan"', "proxy = []"), ["edges[0].proxy is []", "the name of a body or site"]),
    "no name of a proxy": (
        changed('link = "lan"', 'proxy = ""'),
        ["edges[0].proxy is ''", "the name of a body or site"],
    ),
    "tool": (one_hand("tool:box", 6), ["nodes.table: scene tool:box is '2 edges'", NO_ROOM]),
    "follower": (
        changed("dof = 3", 'dof = 3\nfollower.robot = "simulated"\nfollower.motion_scale = 2.0'),
        ["nodes.table: follower.force_scale is 1.0; allowed: 2"],
    ),
    "scene": (changed("mass=0.2&", "mas=0.2&"), ["edges.alice-table: scene block", "'mas'", "did you mean mass?"]),
    "turns": (
        changed("mass=0.2&", "mass=0.2&turns=maybe&"),
        ["edges.alice-table: scene block", "'turns=maybe'", "turns: no, or yes with three axes"],
    ),
    "turns on two axes": (
        changed("mass=0.2&", "mass=0.2&turns=yes&").replace("dof = 3", "dof = 2"),
        ["scene block", "'turns=yes'", "with three axes"],
    ),
    "friction": (
        changed("mass=0.2&", "mass=0.2&friction=-1&"),
        ["edges.alice-table: scene block", "'friction=-1'", "friction: 0 or above"],
    ),
    **{
        law: (f'coupling = "{law}"\n' + GOOD, [f"coupling is '{law}'", "has a spring in the scene", "such as pspm"])
        for law in ("pd", "wave", "tdpa", "digital-wave")
    },
    "axes of at": (changed("dof = 3", "dof = 2"), ["edges.alice-table.at", "allowed: 2 lengths, one for each axis"]),
    "axes": (changed("dof = 3", "dof = 6"), ["edges.alice-table: dof is 6", "allowed: 1, 2 or 3"]),
    "coupled axes": (
        changed("dof = 3", "dof = 3\nworld.mass = [[1.0, 0.1, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 1.0]]"),
        ["world.mass is ((1.0, 0.1", "allowed: a number, or one for each axis"],
    ),
    "an edge's name twice": (
        changed('link = "lan"', 'name = "x"').replace("at = [0.06", 'name = "x"\nat = [0.06'),
        ["edges[1].name is 'x'", "allowed: a name that no other edge has"],
    ),
    "an edge's name that is a path": (
        changed('link = "lan"', 'name = "../x"'),
        ["edges[0].name is '../x'", "allowed: up to 80 letters"],
    ),
    "an edge's name that is none": (changed('link = "lan"', "name = 5"), ["edges[0].name is 5", "such as left-hand"]),
    "free": (
        changed("nodes.bob", "nodes.free").replace('from = "bob"', 'from = "free"'),
        ["nodes is 'free'", "names other than free"],
    ),
    "rights": (changed('link = "lan"', 'rights = "wach"'), ["edges[0].rights 'wach'", "did you mean watch?"]),
    "rights in a list": (changed('link = "lan"', "rights = []"), ["edges[0].rights is []", "touch or watch"]),
    "rights among walls": (
        changed(SHARED, "wall").replace("at = [0.06, 0, 0]", 'rights = "watch"'),
        ["edges.bob-table.rights is 'watch'", "left out in the scene wall"],
    ),
    **BAD_LEADERS,
    "duration": (changed("0.2", "-1"), ["duration_s is -1.0", "allowed: 0 to"]),
    "TOML": (GOOD + "x = = 1\n", ["g.toml", "line 19"]),
    "binary": ("\0\1\2", ["g.toml", "a TOML file with nodes and edges"]),
}
