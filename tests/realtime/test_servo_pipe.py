"""A sample's way through a pipe, which knows no named tuples."""

import pytest

from hapnet.control.coupling import CouplingSample, MotionSample, PortSample, WaveSample
from hapnet.realtime.servo_pipe import Pipe, kind_of, sample_of, socket_pair


@pytest.mark.parametrize(
    "sample",
    [
        (0.1, -0.0, 5e-324),
        (0.5, 1e-3),  # as long as a wave or a port, and none
        MotionSample((0.1, 0.2), (-1.0, 0.0)),
        PortSample((1.5,), 1e-9),
        WaveSample((0.25, 0.0, 1.0), 5e-3),
    ],
)
def test_a_sample_goes_through_a_pipe(sample: CouplingSample) -> None:
    ours, theirs = map(Pipe, socket_pair())
    assert ours.offer("arrive", kind_of(sample), sample, 1.5)
    frame = theirs.look()
    assert frame is not None
    word, kind, values, sent_s = frame
    again = sample_of(kind, values)
    assert (word, sent_s) == ("arrive", 1.5)
    assert again == sample
    assert type(again) is type(sample)
    ours.close()
    theirs.close()
