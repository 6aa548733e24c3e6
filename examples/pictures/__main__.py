"""Makes the pictures of README and the pages and writes them into examples/.

python -m examples.pictures                                 # all of them, in an hour
python -m examples.pictures run.png mesh.png                # these
python -m examples.pictures --list                          # the pictures, with their commands
"""

from __future__ import annotations

import argparse
import hashlib
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LINK = "--delay 40ms --jitter 10ms --loss 2%"
SHOWN = "pspm,zoh,popc,eba,tdpa,wave,digital-wave,pd"
COMPARED = f"--coupling {SHOWN} --set device.stiffness=100 --deadband 0 --case 4g,hand-21,0"
STAGED = "pspm,zoh,popc:rendering=hapnet,eba:rendering=hapnet,pd:rendering=hapnet,two-layer:rendering=hapnet"
DIFFERENT = f"--coupling {STAGED} --deadband 0"


@dataclass(frozen=True)
class Recipe:
    """Commands of hapnet or programs of this folder that write into DIR, and the file in DIR for each picture."""

    commands: tuple[str, ...]
    pictures: dict[str, str]


def simulated(picture: str, flags: str) -> Recipe:
    return Recipe((f"hapnet simulate {flags} --out DIR",), {picture: "figure.png"})


def scene(picture: str, flags: str) -> Recipe:
    return Recipe(
        (f"hapnet simulate {flags} --out DIR", "hapnet report DIR/run.mcap --out DIR"), {picture: "run-scene.png"}
    )


RECIPES = (
    simulated("run.png", f"{LINK} --seed 1"),
    Recipe(("examples.pictures.credit --out DIR",), {"credit.png": "credit.png"}),
    Recipe(("examples.pictures.drag --out DIR",), {"drag.png": "drag.png"}),
    Recipe(("examples.pictures.grain --out DIR",), {"grain.png": "grain.png"}),
    Recipe(("examples.pictures.peg --out DIR",), {"peg.gif": "peg.gif"}),
    Recipe(("examples.pictures.soft --out DIR",), {"soft.gif": "soft.gif"}),
    Recipe(("examples.pictures.ten_minutes --out DIR",), {"ten-minutes.png": "ten-minutes.png"}),
    scene(
        "mesh.png",
        "--scene 'mesh:examples/ring.obj?unit=mm&friction=0.3' --operator hand-6 --link 4g --duration 20 --seed 3",
    ),
    scene(
        "gyroid.png",
        "--scene 'sdf:examples.fields:gyroid?friction=0.2' --operator hand-6 --link 4g --duration 20 --seed 3",
    ),
    scene(
        "head.png",
        "--scene 'sdf:examples.fields:head?stiffness=600&layers=6mm,3000' --operator hand-6 --link 4g "
        "--duration 20 --seed 3",
    ),
    scene(
        "arm.png",
        "--device omni --scene 'sphere?radius=20mm&at=0,0,-25mm' --operator hand-6 --link 4g --duration 8 --seed 3",
    ),
    scene("dominoes.png", "--scene mujoco:examples/dominoes.xml --operator press --duration 6 --seed 1"),
    scene("planet.png", "--scene examples.planet:planet --operator hand-6 --duration 12 --seed 1"),
    Recipe(("hapnet transparency --link 4g --out DIR",), {"transparency.png": "transparency.png"}),
    Recipe(("hapnet tune examples/tune/pspm.toml --out DIR",), {"tune.png": "tune.png"}),
    Recipe((f"hapnet compare --bench hands --link 4g --operator hand-21 {COMPARED} --out DIR",),
           {"traces.png": "hands/traces.png"}),
    Recipe((f"hapnet compare --bench hands --link 4g {DIFFERENT} "
            "--set scene=examples.pictures.lying:liar --out DIR/lying",
            f"hapnet compare --bench moves --link 4g {DIFFERENT} --out DIR/moving",
            "examples.pictures.compare --table DIR --out DIR"), {"compared.csv": "compared.csv"}),
    Recipe(("examples.pictures.compare --out DIR",), {"compare.png": "compare.png"}),
    Recipe(("hapnet compare --bench arms --out DIR", "examples.pictures.bilateral --table DIR --out DIR"),
           {"bilateral.csv": "bilateral.csv"}),
    Recipe(("examples.pictures.bilateral --out DIR",), {"bilateral.png": "bilateral.png"}),
)  # fmt: skip
FILM = "play.gif"


SUMS = ROOT / "examples" / "pictures" / "SHA256SUMS"
"""The digest of each file, as `sha256sum` writes it: a picture that was changed by hand has another."""


def make(recipe: Recipe, directory: Path) -> None:
    """Run the commands in a temporary directory and copy the pictures into `directory`."""
    with tempfile.TemporaryDirectory() as there:
        here = Path(there)
        (here / "examples").symlink_to(ROOT / "examples")
        for command in recipe.commands:
            words = shlex.split(command.replace("DIR", "out"))
            subprocess.run([sys.executable, "-m", *words], cwd=here, check=True, stdout=subprocess.DEVNULL)
        for picture, made in recipe.pictures.items():
            shutil.copyfile(here / "out" / made, directory / picture)


def sums(file: Path = SUMS) -> dict[str, str]:
    """The digests that were written down, by the file's name."""
    pairs = (line.split("  ") for line in file.read_text("utf-8").splitlines())
    return {name: digest for digest, name in pairs}


def digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def write_down(names: Iterable[str]) -> None:
    known = sums() | {name: digest(ROOT / "examples" / name) for name in names}
    SUMS.write_text("".join(f"{known[name]}  {name}\n" for name in sorted(known)), "utf-8")


def main() -> None:
    known = [*(picture for recipe in RECIPES for picture in recipe.pictures), FILM]
    parser = argparse.ArgumentParser(prog="python -m examples.pictures")
    parser.add_argument("picture", nargs="*", help=f"of {', '.join(known)}; all without any")
    parser.add_argument("--list", action="store_true", help="print the command of each picture and exit")
    given = parser.parse_args()
    if wrong := set(given.picture) - set(known):
        parser.error(f"no such picture: {', '.join(sorted(wrong))}; there are {', '.join(known)}")
    wanted = set(given.picture or known)
    for recipe in (recipe for recipe in RECIPES if wanted & set(recipe.pictures)):
        print(f"{', '.join(recipe.pictures)}: {'; '.join(recipe.commands)}", flush=True)
        if not given.list:
            make(recipe, ROOT / "examples")
            write_down(recipe.pictures)
    if FILM in wanted:
        print(f"{FILM}: the page of `hapnet play`, in a browser", flush=True)
        if not given.list:
            from examples.pictures.film import film  # imported here because it needs a browser

            film(ROOT / "examples" / FILM)
            write_down([FILM])


if __name__ == "__main__":
    main()
