"""A model that claims to be larger than any is refused before MuJoCo makes it."""

from pathlib import Path

import pytest

from hapnet.ext.engines.mujoco_sizes import check_sizes

GEOM = '<geom size="0.01"/>'


def check(folder: Path, text: str) -> None:
    file = folder / "model.xml"
    file.write_text(f"<mujoco>{text}</mujoco>", "utf-8")
    check_sizes(file)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f'<replicate count="10001">{GEOM}</replicate>', r"its replicate claims 1e\+04 \(count\), 1e\+04 are"),
        (f"<replicate sep='>' count='99'><replicate count='&#57;99'>{GEOM}", r"its replicate claims 9.89e\+04"),
        ('<flexcomp type="grid" count="100 100 3"/>', r"its flexcomp claims 3e\+04 \(count\)"),
        ('<hfield nrow="60000" ncol="60000"/>', r"its hfield claims 3.6e\+09 \(nrow times ncol\)"),
        ('<texture type="cube" builtin="flat" width="5000"/>', r"its texture claims 2.5e\+07 \(width times height\)"),
        ('<size memory="300M"/>', r"its size claims memory 3.15e\+08, 2.56e\+08 are allowed"),
        ('<size nkey="5" nuserdata="2000000000"/>', r"its size claims nuserdata 2e\+09"),
        ('<worldbody/><size njmax="nan"/>', "its size claims njmax nan"),
    ],
)
def test_claims_are_bounded(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=said):
        check(tmp_path, text)
    (tmp_path / "part.xml").write_text(f"<mujocoinclude>{text}</mujocoinclude>", "utf-8")
    with pytest.raises(ValueError, match=said):
        check(tmp_path, '<include file="part.xml"/>')


def test_what_is_usual_is_allowed(tmp_path: Path) -> None:
    """Replicates side by side, one in another, in comments that are not XML, and files that include each other."""
    check(
        tmp_path,
        '<!-- <replicate count="1e9"> -- --><size memory="200M" njmax="500000"/>'
        '<texture builtin="checker" width="2048" height="2048"/><hfield file="h.png" size="1 1 1 1"/>'
        + f'<replicate count="900">{GEOM}</replicate>'
        * 20
        + f'<replicate count="90"><replicate count="90">{GEOM}</replicate></replicate><replicate count="900"/>'
        '<include file="model.xml"/><include file="missing.xml"/>',
    )
