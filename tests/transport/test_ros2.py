"""What hapnet puts on ROS 2's network, beside rclpy's own bytes and the examples that rmw_zenoh's design prints.

The bytes and hashes are those of rclpy 7.1.6 (`rclpy.serialization.serialize_message`; wheel ros-jazzy-rclpy for Python
3.12) and of the type descriptions in its messages' wheels, 5.3.6. rclpy leaves padding as it finds it in memory.
"""

from typing import Any

import pytest

from hapnet.errors import BadMessage, InvalidParameter
from hapnet.transport.ros2 import (
    Attachment,
    RosNode,
    Types,
    check_topic,
    endpoint_token,
    node_token,
    topic_key,
)

np = pytest.importorskip("numpy")
pytest.importorskip("rosbags.typesys")
pytest.importorskip("xxhash")

SESSION = "aac3178e146ba6f1fc6e6a4085e77f21"
STRING = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
HASHES = {
    "geometry_msgs/msg/PoseStamped": "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
    "geometry_msgs/msg/TwistStamped": "5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
    "geometry_msgs/msg/WrenchStamped": "8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
    "sensor_msgs/msg/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "diagnostic_msgs/msg/DiagnosticArray": "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
_HEAD = "0001000018ee266915cd5b07070000006861706e657400 "  # encapsulation, stamp, frame
_TWELVE = "9a9999999999b93f9a9999999999c9bf333333333333d33f000000000000f03f000000000000004000000000000008c0"
BYTES = {  # xx: padding
    "geometry_msgs/msg/PoseStamped": "xxxxxxxxxx7b14ae47e17a843f7b14ae47e17a94bfb81e85eb51b89e3f"
    "000000000000e03f000000000000e0bf000000000000e03f000000000000e03f",
    "geometry_msgs/msg/TwistStamped": "xxxxxxxxxx" + _TWELVE,
    "geometry_msgs/msg/WrenchStamped": "xxxxxxxxxx" + _TWELVE,
    "sensor_msgs/msg/JointState": "xx02000000080000006a6f696e745f7800090000006a6f696e745f797900xxxxxx"
    "020000009a9999999999b93f9a9999999999c93f02000000xxxxxxxx333333333333d33f9a9999999999d93f"
    "02000000xxxxxxxx000000000000e03f333333333333e33f",
    "diagnostic_msgs/msg/DiagnosticArray": "xx0100000002xxxxxx1e0000006861706e65743a206163636f756e74206f66207468652064"
    "657669636500xxxx0100000000xxxxxx070000006861706e657400xx02000000090000006d617267696e5f4a00xxxxxx"
    "060000002d302e323500xxxx08000000736c61636b5f4a000600000031652d313200",
}


@pytest.fixture(scope="module")
def types() -> Types:
    return Types()


def message(types: Types, kind: str) -> Any:
    """The message that rclpy was given."""

    def make(name: str, *values: Any) -> Any:
        return types.classes[name](*values)

    def two(one: str) -> Any:
        first, second = make("geometry_msgs/msg/Vector3", 0.1, -0.2, 0.3), make("geometry_msgs/msg/Vector3", 1, 2, -3)
        return make(one, first, second)

    header = make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", 1_764_159_000, 123_456_789), "hapnet")
    place, turn = make("geometry_msgs/msg/Point", 0.01, -0.02, 0.03), (0.5, -0.5, 0.5, 0.5)
    pairs = [make("diagnostic_msgs/msg/KeyValue", *pair) for pair in (("margin_J", "-0.25"), ("slack_J", "1e-12"))]
    status = make("diagnostic_msgs/msg/DiagnosticStatus", 2, "hapnet: account of the device", "", "hapnet", pairs)
    joints = (["joint_x", "joint_yy"], np.array([0.1, 0.2]), np.array([0.3, 0.4]), np.array([0.5, 0.6]))
    rest = {
        "PoseStamped": lambda: (make("geometry_msgs/msg/Pose", place, make("geometry_msgs/msg/Quaternion", *turn)),),
        "TwistStamped": lambda: (two("geometry_msgs/msg/Twist"),),
        "WrenchStamped": lambda: (two("geometry_msgs/msg/Wrench"),),
        "JointState": lambda: joints,
        "DiagnosticArray": lambda: ([status],),
    }
    return make(kind, header, *rest[kind.rpartition("/")[2]]())


@pytest.mark.parametrize("kind", BYTES)
def test_bytes_and_hashes_are_those_of_rclpy(types: Types, kind: str) -> None:
    ours = types.encode(kind, message(types, kind)).hex()
    theirs = (_HEAD + BYTES[kind]).replace(" ", "")
    assert len(ours) == len(theirs)
    assert "".join("x" if b == "x" else a for a, b in zip(ours, theirs, strict=True)) == theirs
    assert types.hash(kind) == f"RIHS01_{HASHES[kind]}"
    rubbish = bytes.fromhex(theirs.replace("x", "a"))  # what padding holds does not matter
    assert types.encode(kind, types.decode(kind, rubbish)).hex() == ours
    with pytest.raises(BadMessage):
        types.decode(kind, bytes.fromhex(ours)[:-9])


def test_keys_and_tokens_are_those_that_the_design_prints(types: Types) -> None:
    """docs/design.md of ros2/rmw_zenoh, "Topic and Service name mapping" and "Graph Cache": talker and listener."""
    kind = "std_msgs/msg/String"
    assert types.hash(kind) == STRING
    assert topic_key(0, "/chatter", kind, STRING) == f"0/chatter/std_msgs::msg::dds_::String_/{STRING}"
    assert topic_key(0, "/robot1/chatter", kind, STRING) == f"0/robot1/chatter/std_msgs::msg::dds_::String_/{STRING}"
    node = node_token(2, SESSION, "/", "listener")
    assert node == f"@ros2_lv/2/{SESSION}/0/0/NN/%/%/listener"
    assert endpoint_token(node, 10, "MS", "/chatter", kind, STRING) == (
        f"@ros2_lv/2/{SESSION}/0/10/MS/%/%/listener/%chatter/std_msgs::msg::dds_::String_/{STRING}/::,10:,:,:,,"
    )
    assert "/NN/%/%left%arm/b" in node_token(0, SESSION, "/left/arm", "b")


def test_an_attachment_is_what_zenoh_serialises() -> None:
    """ "8 bytes for the sequence number ..., 1 byte for the length of the publisher GID" (design.md, "Publishers")."""
    import zenoh.ext as ext

    gid = bytes(range(16))
    data = Attachment(7, 1_764_159_000_123_456_789, gid).encode()
    assert data == ext.z_serialize((ext.Int64(7), ext.Int64(1_764_159_000_123_456_789), gid)).to_bytes()
    assert Attachment.decode(data) == (7, 1_764_159_000_123_456_789, gid)
    for wrong in (b"", data[:-1], data[:16] + b"\x18" + data[17:]):
        with pytest.raises(BadMessage):
            Attachment.decode(wrong)


@pytest.mark.parametrize("name", ["", "target", "/", "/a//b", "/a/", "/1a", "/a b", "/ä", "/a/*"])
def test_what_is_no_name_of_ros_is_refused(name: str) -> None:
    with pytest.raises(InvalidParameter, match="state"):
        check_topic("state", name)


def test_a_node_of_no_domain_is_refused() -> None:
    with pytest.raises(InvalidParameter, match="0 to 232"):
        RosNode("a", domain=233)
    with pytest.raises(InvalidParameter, match="tcp"):
        RosNode("a", router="localhost")
