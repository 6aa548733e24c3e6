"""Wrong inputs of users: what is typed, the files that it needs, and the words that the answer must have."""

from typing import NamedTuple

QUICK = ("simulate", "--duration", "0.3")
EMPTY = ("--set", "device.ceiling_J=0", "--set", "world.ceiling_J=0")


class Bad(NamedTuple):
    """`argv` of the command `program`, and `says`, which must be in its one line."""

    argv: tuple[str, ...]
    says: tuple[str, ...]
    program: str = "hapnet"


def bad(*argv: str, says: str, program: str = "hapnet") -> Bad:
    """`says` : the words, with | between them."""
    return Bad(argv, tuple(says.split("|")), program)


PARTS = """
import asyncio
import dataclasses
import sys
from hapnet import Plane, Scene, held_law, stepped_law
from hapnet.couplings.registry import COUPLINGS

def leaves(**given):
    raise SystemExit(3)

class Stepping:
    dof = 1
    def step(self, dt, position, velocity): return [0.0]

class ToldNumbers(Stepping):
    def planes(self, position, reach_m): return [1, 2]

class ToldOne(Stepping):
    def planes(self, position, reach_m): return 7

class LongNormal(Stepping):
    def planes(self, position, reach_m): return [Plane((2.0,), 0.0, 100.0, 1.0)]

class Supplied(Stepping):
    supplied_J = "x"

class Stored(Stepping):
    stored_J = float("nan")

class Exits(Stepping):
    def step(self, dt, position, velocity): sys.exit("enough")

class Generates(Stepping):
    def step(self, dt, position, velocity): raise GeneratorExit

class Cancels(Stepping):
    def step(self, dt, position, velocity): raise asyncio.CancelledError

class Weary(BaseException): pass

class Wearies(Stepping):
    def step(self, dt, position, velocity): raise Weary("no more")

class Wide(Stepping):
    dof = 10**6

class Unpictured(Scene):
    def picture(self): return 5

def unpictured(*, dof=1): return Unpictured("unpictured", dof)

class TwoForces(Stepping):
    def step(self, dt, position, velocity): return [0.0, 1.0]

class Silent(Stepping):
    def signals(self): return 7

class Named(Stepping):
    name = 7
    dof = "two"

class World:
    name, dof, start, walls, surfaces = "w", 1, (0.0,), (), ()
    contacts = None
    def next_step_s(self, rng): return 0.01
    def towards(self, position): return position

class Hand:
    def __init__(self, dof, impedance): self.impedance = impedance
    def reference(self, t): return (float("nan"),)

class LeavingHand(Hand):
    def reference(self, t): sys.exit(0)

class Arm:
    dof, force_limit, resolution = 1, 3.0, 0.0
    def __init__(self, dof): pass
    def read(self): return (0.0,), (0.0,)
    def apply(self, force): return (1e30,)

class Limitless(Arm):
    force_limit = None

class ExitingArm(Arm):
    def apply(self, force): sys.exit(0)

class Unplugged(Arm):
    def __init__(self, dof): raise OSError("no such port")

class Unread(Arm):
    def read(self): sys.exit(0)

def valued(value):
    def law(position, velocity, time): return value
    return law

no_number, nothing, words = valued([float("nan")]), valued(None), valued("force")

def unlucky(position, velocity, time): raise ValueError("no\\nluck")
def deep(position, velocity, time): return deep(position, velocity, time)
def full(position, velocity, time): raise MemoryError
async def later(position, velocity, time): return [0.0]
def several(position, velocity, time): yield [0.0]
def timeless(position, velocity): return [0.0]

class Massless(Hand):
    def __init__(self, dof, impedance): self.impedance = None

class Nowhere(Hand):
    def reference(self, t): return None

class Law:
    def __init__(self, start): pass
    def receive(self, sample): pass
    def on_peer_changed(self): pass
    def force(self, dt, x, v, held): return (0.0,) * len(x)
    def release(self, dt, x, held): pass
    def begin(self): pass
    def impedance(self, dt): return 1.0, (0.0,)
    def moved(self, dt, vhat, x, v): pass
    def next_sample(self, *at): return (0.0,)

class Tied(Law):
    set_position = (0.0,)

class Raises(Tied):
    def force(self, dt, x, v, held): return {}["nothing"]

class Pushes(Tied):
    def force(self, dt, x, v, held): return (1.0,)

class Short(Tied):
    def force(self, dt, x, v, held): return None

def law(kind): return dataclasses.replace(COUPLINGS["pd"], device=held_law(kind), world=stepped_law(kind))

Untied, Raising, NoForce = law(Law), law(Raises), law(Short)
Untuned = dataclasses.replace(law(Tied), tune=lambda params, link: 1 / 0)
Boastful = dataclasses.replace(law(Pushes), covers=lambda params, tuning, virtual: 1 / 0)
Unmade = dataclasses.replace(law(Tied), world=lambda start: sys.exit(0))
"""

MODEL = (
    '<mujoco><option timestep="{}"/><worldbody><geom type="plane" size="1 1 .1"/><body pos="0 0 .1"><freejoint/>'
    '<geom size=".02"/></body></worldbody></mujoco>'
)

FILES = {
    "parts.py": PARTS,
    "exits.py": "raise SystemExit",
    "syntax.py": "def",
    "still.xml": MODEL.format(0),
    "slow.xml": MODEL.format(1e-9),
    "broken.xml": "<mujoco><worldbody>",
    "one.csv": "time_s,x_m\n0,0\n",
    "words.csv": "time_s,x_m\n0,zero\n1,one\n",
    "back.csv": "time_s,x_m\n1,0\n0,0\n",
    "empty.mcap": "",
    "letter.mcap": "Dear Sir or Madam",
    "empty.obj": "",
    "points.obj": "v 0 0 0\nv 0.01 0 0\n",
    "heights.txt": "1 2 3\n4 5\n",
    "list.toml": "device = 3\n",
    "bytes.toml": "\u0000",
    "axis.toml": "[vary]\ndevice.nosuch = [1, 2]\n",
    "nothing.toml": "",
    "spec.toml": "[vary]\nseed = 'all'\n",
    "large.toml": "[vary]\nseed = [99999999999999999999999]\n",
    "tune.toml": "[tune]\nobjective = { nosuch = 1.0 }\n[search]\n'contact_model.lead' = {}\n",
    "users.txt": "nobody\n",
    "soft.toml": "[device]\nstiffness = 'soft'\n",
    "truth.toml": "[device]\nstiffness = true\n",
    "typo.toml": "[device]\nstiffnes = 3\n",
    "array.toml": "duration_s = [1]\n",
    "twice.toml": "[device]\nstiffness = 1\n[device]\nstiffness = 2\n",
    "nan.csv": "time_s,x_m\n0,nan\n1,0\n",
    "huge.csv": "time_s,x_m\n0,1e300\n1,0\n",
    "head.mcap": "\u0089MCAP0\r\n",
    "empty.xml": "",
    "trace.txt": "three\n",
    "zenoh.json5": "{mode: }",
}

ISSUE = [
    bad(*QUICK, "--scene", "parts:ToldNumbers", says="the scene ToldNumbers failed|[1, 2]|hapnet.Plane"),
    bad(*QUICK, "--scene", "parts:Supplied", says="the scene Supplied failed|supplied_J|'x'"),
    bad(*QUICK, "--scene", "mujoco:still.xml", says="still.xml is 0 s|1e-05 to 1 s"),
    bad(*QUICK, "--scene", "mujoco:slow.xml", says="slow.xml is 1e-09 s|1e-05 to 1 s"),
    bad(*QUICK, "--scene", "exits:Scene", says="exits:Scene|SystemExit"),
    bad(*QUICK, "--coupling", "parts:Untied", says="the coupling parts:Untied failed|Law has no set_position"),
    bad(*QUICK, "--scene", "mesh:nothere.obj", says="mesh:nothere.obj|No such file"),
    bad(*QUICK, "--operator", "hand-0", says="hand-0|hand-N (N from 1)"),
    bad(*QUICK, "--rate", "0bit", says="'0bit'|such as 1mbit"),
    bad(*QUICK, "--seed", "12345678901234567890123", says="--seed|9223372036854775807"),
]

OWN_PARTS = [
    bad(*QUICK, "--scene", "syntax:Scene", says="syntax:Scene|SyntaxError"),
    bad(*QUICK, "--scene", "parts:leaves", says="parts:leaves|SystemExit"),
    bad(*QUICK, "--scene", "parts:ToldOne", says="the scene ToldOne failed|gave 7|hapnet.Plane"),
    bad(*QUICK, "--scene", "parts:LongNormal", says="the scene LongNormal failed|unit vector"),
    bad(*QUICK, "--scene", "parts:Stored", says="the scene Stored failed|stored_J|nan"),
    bad(*QUICK, "--scene", "parts:Exits", says="the scene Exits failed|step()|enough"),
    bad(*QUICK, "--scene", "parts:Generates", says="the scene Generates failed: step() raised GeneratorExit"),
    bad(*QUICK, "--scene", "parts:Cancels", says="the scene Cancels failed: step() raised CancelledError"),
    bad(*QUICK, "--scene", "parts:Wearies", says="the scene Wearies failed: step() raised Weary: no more"),
    bad(*QUICK, "--scene", "parts:Wide", says="parts:Wide|dof is 1000000|1 to 64"),
    bad(*QUICK, "--scene", "parts:unpictured", says="the scene parts:unpictured failed|picture() gave 5, not what"),
    bad(*QUICK, "--scene", "parts:TwoForces", says="the scene TwoForces failed|[0.0, 1.0]|1 finite number"),
    bad(*QUICK, "--scene", "parts:Silent", says="the scene parts:Silent failed|signals"),
    bad(*QUICK, "--scene", "parts:Named", says="parts:Named|dof|two"),
    bad(*QUICK, "--scene", "parts:World", says="parts:World|failed"),
    bad(*QUICK, "--scene", "parts", says="scene is 'parts'|free, wall"),
    bad(*QUICK, "--scene", "parts:", says="scene is 'parts:'|module:Name"),
    bad(*QUICK, "--operator", "parts:Hand", says="parts:Hand|nan|1 finite numbers"),
    bad(*QUICK, "--operator", "parts:LeavingHand", says="parts:LeavingHand|SystemExit"),
    bad(*QUICK, "--coupling", "parts:Raising", says="the coupling parts:Raising failed|KeyError: 'nothing'"),
    bad(*QUICK, "--coupling", "parts:NoForce", says="the coupling parts:NoForce failed|TypeError"),
    bad(*QUICK, "--coupling", "parts:Untuned", says="the coupling parts:Untuned failed|ZeroDivisionError"),
    bad(*QUICK, "--no-files", "--coupling", "parts:Boastful", *EMPTY, says="parts:Boastful failed|ZeroDivisionError"),
    bad(*QUICK, "--coupling", "parts:Unmade", says="the coupling parts:Unmade failed|SystemExit"),
    bad(*QUICK, "--coupling", "parts:Law", says="parts:Law|a CouplingSpec"),
    bad("run", "--device", "parts:Unread", says="parts:Unread|SystemExit"),
    bad("run", "--device", "exits:Arm", says="exits:Arm|SystemExit"),
    bad(
        "compare", "--coupling", "parts:Untied", "--bench", "quick", "--workers", "1", says="parts:Untied|set_position"
    ),
    bad("doctor", "--device", "parts:Unread", says="parts:Unread|SystemExit"),
]

WORLDS = [
    bad(*QUICK, "--scene", "mujoco:broken.xml", says="broken.xml|can load"),
    bad(*QUICK, "--scene", "mujoco:nothere.xml", says="no file nothere.xml"),
    bad(*QUICK, "--scene", "mesh:points.obj", says="mesh:points.obj|unit=mm"),
    bad(*QUICK, "--scene", "mesh:empty.obj?unit=mm", says="empty.obj|not empty"),
    bad(*QUICK, "--scene", "mesh:points.obj?unit=mm", says="points.obj"),
    bad(*QUICK, "--scene", "mesh:parts.py?unit=mm", says="parts.py|.stl, .obj, .ply"),
    bad(*QUICK, "--scene", "mesh:points.obj?unit=furlong", says="unit=furlong|mm"),
    bad(*QUICK, "--scene", "heights:heights.txt?unit=mm&spacing=1mm", says="heights.txt|all of one length"),
    bad(*QUICK, "--scene", "sphere?radius=3", says="radius=3|20mm"),
    bad(*QUICK, "--scene", "sphere?colour=red", says="colour|radius"),
    bad(*QUICK, "--scene", "sphere?radius=-3mm", says="radius|above 0"),
    bad(*QUICK, "--scene", "sphere + wall", says="wall|sphere, cuboid"),
    bad(*QUICK, "--operator", "one.csv", says="one.csv"),
    bad(*QUICK, "--operator", "words.csv", says="words.csv"),
    bad(*QUICK, "--operator", "back.csv", says="back.csv"),
    bad(*QUICK, "--operator", "letter.mcap", says="letter.mcap"),
    bad(*QUICK, "--params", "list.toml", says="device"),
    bad(*QUICK, "--params", "bytes.toml", says="bytes.toml|TOML"),
    bad(*QUICK, "--set", "world.step_min_s=1", says="world.step_min_s|world.step_max_s"),
    bad(*QUICK, "--set", "device.stiffness=1e999", says="device.stiffness|finite"),
    bad(*QUICK, "--servo-hz", "1e9", says="--servo-hz|20000"),
    bad(*QUICK, "--deadband", "2", says="--deadband|0 to 1"),
]

LINKS = [
    bad(*QUICK, "--link", "delay 1h", says="1h|ms"),
    bad(*QUICK, "--link", "loss gemodel 1% 200%", says="200%|0% to 100%"),
    bad(*QUICK, "--link", "duplicate 1%", says="duplicate|arrives twice"),
    bad(*QUICK, "--link", "trace trace.txt", says="trace.txt"),
    bad(*QUICK, "--link", "trace nothere.txt", says="nothere.txt"),
    bad(*QUICK, "--rate", "1furlong", says="1furlong|1mbit"),
    bad(*QUICK, "--timeline", "at 1s: sideways", says="sideways"),
    bad("show", "delay", says="delay|a value", program="netem"),
    bad("show", "--profile", "nosuch", says="nosuch|lossy-wifi", program="netem"),
    bad("show", "rate 0kbit", says="0kbit|1mbit", program="netem"),
    bad("udp", "--listen", "here", "--to", "127.0.0.1:1", says="here", program="netem"),
    bad("udp", "--listen", "127.0.0.1:99999", "--to", "127.0.0.1:1", says="99999", program="netem"),
    bad("zenoh", "--listen", "nowhere", "--connect", "tcp/127.0.0.1:1", says="nowhere", program="netem"),
]

COMMANDS = [
    bad("compare", "--seeds", "3:1", says="--seeds|3:1|A:B"),
    bad("compare", "--seeds", "0:99999999999999999999999", says="--seeds|18 digits"),
    bad("compare", "--bench", "nosuch", says="nosuch|quick"),
    bad("compare", "--case", "nosuch", says="nosuch"),
    bad("sweep", "axis.toml", says="axis.toml|device.nosuch"),
    bad("sweep", "nothing.toml", says="nothing.toml"),
    bad("sweep", "spec.toml", says="spec.toml|'all'|'A:B'"),
    bad("sweep", "large.toml", says="large.toml|seed|64 bits"),
    bad("sweep", "nothere.toml", says="nothere.toml"),
    bad("sweep", "plot", "nothere", says="nothere"),
    bad("tune", "tune.toml", says="tune.toml|vary is []"),
    bad("tune", "nothere.toml", says="nothere.toml"),
    bad("view", "letter.mcap", says="letter.mcap|not a recording"),
    bad("view", "-e", "127.0.0.1:1", says="127.0.0.1:1|tcp/"),
    bad("view", "--port", "70000", says="--port|65535"),
    bad("view", "--host", "256.0.0.1", says="256.0.0.1"),
    bad("bridge", "ros1", says="ros1|ros2"),
    bad("bridge", "ros2", "-e", "tcp/127.0.0.1:1", "--namespace", "left", says="namespace|left|/robot"),
    bad("replay", "empty.mcap", says="empty.mcap|not a recording"),
    bad("replay", "nothere.mcap", "--out", "new/one", says="nothere.mcap"),
    bad("report", "letter.mcap", "--out", "new/one", says="letter.mcap|not a recording"),
    bad("export", "letter.mcap", "--out", "new/one", says="letter.mcap|not a recording"),
    bad("export", "letter.mcap", "--format", "xls", says="xls|csv"),
    bad("emulate", "nosuch", says="nosuch|serial"),
    bad("emulate", "serial:noise=loud", says="noise|loud"),
    bad("emulate", "serial", "--duration", "-1", says="--duration|-1"),
    bad("doctor", "--device", "xyz", says="xyz|serial"),
    bad("doctor", "--ramp", "1", says="--ramp|--device"),
    bad("doctor", "-e", "tcp/nowhere.invalid", says="nowhere.invalid"),
    bad("device", "--device", "serial:/dev/nothere", "-e", "tcp/127.0.0.1:1", says="/dev/nothere"),
    bad(
        "device", "-e", "tcp/127.0.0.1:1", "--record", "new/one/x.mcap", "--device", "parts:Unread", says="parts:Unread"
    ),
    bad("device", "-c", "zenoh.json5", says="zenoh.json5"),
    bad("device", "-e", "tcp/127.0.0.1:1", "--tls-ca", "nothere.pem", says="nothere.pem"),
    bad("world", "-l", "tcp/127.0.0.1:0x", says="127.0.0.1:0x"),
    bad("world", "-l", "tcp/127.0.0.1:1", "--users", "users.txt", says="users.txt|user:password"),
    bad("world", "-l", "tcp/256.0.0.1:17447", says="256.0.0.1"),
    bad("play", "--coupling", "nosuch", says="nosuch|pspm"),
    bad("play", "--seats", "0", says="--seats is '0'; allowed: 1 to 64"),
    bad("transparency", "--seeds", "one", says="--seeds|A:B"),
    bad("reproduce", "fig4", "--duration", "0", says="duration above 0"),
    bad("bench", "--only", "", says="--only"),
]

SLOW = [
    bad(
        "run", "--coupling", "parts:Raising", "--realtime", says="the coupling parts:Raising failed|KeyError: 'nothing'"
    ),
    bad("run", "--device", "parts:Unplugged", says="parts:Unplugged|OSError: no such port"),
    bad("run", "--device", "parts:Unplugged", "--realtime", says="parts:Unplugged|OSError: no such port"),
    bad("run", "--device", "parts:Arm", says="the device parts:Arm failed|1e+30|force_limit, 3 N"),
    bad("run", "--device", "parts:ExitingArm", says="the device parts:ExitingArm failed|SystemExit"),
    bad("run", "--scene", "parts:Exits", says="the scene Exits failed|enough"),
    bad("run", "--scene", "parts:Supplied", says="the scene Supplied failed|supplied_J|'x'"),
]
"""Two processes each, that are started and paired."""

BY_HAND = [
    bad("run", "--coupling", "parts:Raising", says="the coupling parts:Raising failed|KeyError: 'nothing'"),
    bad("run", "--device", "parts:Limitless", says="the device parts:Limitless failed|1e+30|10000 N"),
    bad("run", "--scene", "parts:Generates", says="the scene Generates failed: step() raised GeneratorExit"),
    bad("run", "--scene", "parts:Cancels", says="the scene Cancels failed: step() raised CancelledError"),
]
"""As `SLOW`; others that are tested there take the same path through the program."""

EVERY = [*ISSUE, *OWN_PARTS, *WORLDS, *LINKS, *COMMANDS]
