"""What others wrote, against our stand-ins and examples; by hand: pip install pyopenhaptics==1.0.1 haplyhapi==1.0.1."""

import math
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from examples.pantograph import CENTRE, Linkage, angles
from tests.support.hd_stand_in import built

pytestmark = pytest.mark.soak

CLIENT = """
import ctypes, time
from pyOpenHaptics import hd
from pyOpenHaptics.hd_callback import hd_callback
from pyOpenHaptics.hd_device import HapticDevice

frames, places = 0, []

@hd_callback
def each_tick():
    global frames
    frames += 1
    places.append(hd.get_transform()[3][0])
    hd.set_force([0.5, 0.0, 0.0])

device = HapticDevice(callback=each_tick, device_name="Default Device")
time.sleep(1.0)
force = (ctypes.c_double * 3)()
ctypes.CDLL("libHD.so").stub_force(force)
device.close()
assert frames > 100, frames
assert max(places) - min(places) > 10.0, (min(places), max(places))
assert abs(force[0] - 0.5) < 1e-9, list(force)
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no C compiler")
@pytest.mark.skipif(find_spec("pyOpenHaptics") is None, reason="pyopenhaptics is not installed")
def test_a_client_of_openhaptics_runs_on_the_stand_in(tmp_path: Path) -> None:
    """Its callback gets the handle's way in millimetres, and its force acts."""
    built(tmp_path)
    environment = os.environ | {"LD_LIBRARY_PATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", CLIENT], env=environment, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr


def test_haplys_own_pantograph_has_the_same_kinematics() -> None:
    theirs = pytest.importorskip("HaplyHAPI").Pantograph(3)
    for x, y in [(0.0, 0.0), (0.02, 0.01), (-0.03, -0.03), (0.03, -0.02)]:
        turned = angles(CENTRE[0] + x, CENTRE[1] + y)
        link = Linkage(*turned)
        theirs.forwardKinematics([math.degrees(angle) for angle in turned])
        theirs.torqueCalculation([0.3, -0.7])
        assert link.handle == pytest.approx((theirs._Pantograph__x_E, theirs._Pantograph__y_E), abs=1e-12)
        assert link.torques((0.3, -0.7)) == pytest.approx(
            (theirs._Pantograph__tau1, theirs._Pantograph__tau2), abs=1e-12
        )
