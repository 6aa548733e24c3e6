"""What is in an MCAP file by Google's own implementation of protobuf, from the schemas that the file itself holds."""

from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader


def messages(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """By topic: log times and messages."""
    read: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as content:
        for schema, channel, message in make_reader(content).iter_messages():
            pool = descriptor_pool.DescriptorPool()
            for described in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                pool.Add(described)
            decode = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            read.setdefault(channel.topic, []).append((message.log_time, decode.FromString(message.data)))
    return read
