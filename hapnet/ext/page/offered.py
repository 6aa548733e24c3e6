"""Checks the messages of a page: only controls that the page was sent, only values that these controls offer.

The messages are viser's. All that is not listed here (tunnels, renderings, the browser's storage, any property of a
control but its value) is refused, and so is a message with a field too many, a missing field, or a field of wrong type.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import msgspec
import zstandard

Coordinate = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Pixels = Annotated[int, msgspec.Meta(ge=0, le=1 << 16)]
Identifier = Annotated[str, msgspec.Meta(max_length=100)]

LONGEST_TEXT = 1000
"""A longer text from a page is refused [characters]."""

LARGEST_UPLOAD = 128 * 1024 * 1024
"""A larger file is refused here [bytes]. The page shows what is wrong with a smaller file."""


class _PageMessage(msgspec.Struct, tag_field="type", forbid_unknown_fields=True):
    """A message from a page, with exactly the fields of its class."""


class Camera(_PageMessage, tag="ViewerCameraMessage"):
    """The camera of a page."""

    wxyz: tuple[Coordinate, Coordinate, Coordinate, Coordinate]
    position: Point
    fov: Annotated[float, msgspec.Meta(gt=0.0, lt=3.15)]
    near: Coordinate
    far: Coordinate
    image_height: Pixels
    image_width: Pixels
    look_at: Point
    up_direction: Point


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    value: bool | int | float | str


class ControlValue(_PageMessage, tag="GuiUpdateMessage"):
    """A control's new value."""

    uuid: Identifier
    updates: _Value


class Submit(_PageMessage, tag="GuiFormSubmitMessage"):
    """The user has pressed Enter in a form."""

    uuid: Identifier


class Dirty(_PageMessage, tag="GuiFormDirtyMessage"):
    """The user types in a form."""

    uuid: Identifier


class Drag(_PageMessage, tag="SceneNodeDragMessage"):
    """The mouse drags a node of the scene."""

    phase: Literal["start", "update", "end"]
    name: Identifier
    instance_index: None
    start_position: Point
    start_screen_pos: tuple[Coordinate, Coordinate]
    end_position: Point
    end_screen_pos: tuple[Coordinate, Coordinate]
    button: Literal["left", "middle", "right"]
    modifier: Identifier | None
    owner: Identifier


class Upload(_PageMessage, tag="FileTransferStartUpload"):
    """The upload of a file begins."""

    source_component_uuid: Identifier
    transfer_uuid: Identifier
    filename: Annotated[str, msgspec.Meta(max_length=255)]
    mime_type: Identifier
    part_count: Annotated[int, msgspec.Meta(ge=0, le=LARGEST_UPLOAD)]
    size_bytes: Annotated[int, msgspec.Meta(ge=0, le=LARGEST_UPLOAD)]


class FilePart(_PageMessage, tag="FileTransferPart"):
    """A part of a file."""

    source_component_uuid: Identifier
    transfer_uuid: Identifier
    part_index: int
    content: bytes


class Offered:
    """The controls that one page was sent, which define the messages that it may send."""

    def __init__(self) -> None:
        self._controls: dict[str, tuple[str, dict[str, Any]]] = {}
        self._draggable: set[str] = set()
        self._upload: tuple[Upload, dict[int, int]] | None = None
        self._messages = msgspec.msgpack.Decoder(Camera | ControlValue | Submit | Dirty | Drag | Upload | FilePart)
        self._unpack = zstandard.ZstdDecompressor().decompress

    def learn(self, frame: bytes) -> None:
        """Store the controls in a frame from viser to the page: sizes, compressed messages, and then bare numbers."""
        length, compressed = int.from_bytes(frame[:8], "little"), int.from_bytes(frame[8:16], "little")
        data = self._unpack(frame[16 : 16 + compressed], max_output_size=length)
        if b"Gui" not in data and b"DragBindings" not in data:
            return
        for message in msgspec.msgpack.decode(data)["messages"]:
            kind, uuid = str(message["type"]), message.get("uuid")
            if kind == "GuiUpdateMessage" and uuid in self._controls:
                self._controls[uuid][1].update(message["updates"])
            elif kind == "GuiRemoveMessage":
                self._controls.pop(str(uuid), None)
            elif kind == "ResetGuiMessage":
                self._controls.clear()
            elif kind == "SetSceneNodeDragBindingsMessage":
                (self._draggable.add if message["bindings"] else self._draggable.discard)(message["name"])
            elif kind.startswith("Gui") and uuid is not None and isinstance(props := message.get("props"), dict):
                self._controls[uuid] = kind, dict(props)

    def checked(self, message: bytes | str) -> bytes | None:
        """The message, encoded again, for viser; None: it is refused."""
        if isinstance(message, str):
            return None
        try:
            found = self._messages.decode(message)
        except (ValueError, RecursionError):  # all that msgspec raises, and UnicodeDecodeError
            return None
        return msgspec.msgpack.encode(found) if self._permits(found) else None

    def _permits(self, message: Camera | ControlValue | Submit | Dirty | Drag | Upload | FilePart) -> bool:
        match message:
            case Camera():
                return any(message.wxyz) and message.look_at != message.position
            case ControlValue():
                kind, props = self._enabled(message.uuid)
                return kind in _VALUES and _VALUES[kind](message.updates.value, props)
            case Submit() | Dirty():
                return self._enabled(message.uuid)[0] == "GuiFormMessage"
            case Drag():
                return message.name in self._draggable
            case Upload():
                return self._begins(message)
            case FilePart():
                return self._continues(message)

    def _enabled(self, uuid: str) -> tuple[str, Mapping[str, Any]]:
        """A control's kind and properties; the kind is "" if the page has no such control, or it is disabled."""
        kind, props = self._controls.get(uuid, ("", {}))
        return ("", {}) if props.get("disabled") or not props.get("visible", True) else (kind, props)

    def _begins(self, upload: Upload) -> bool:
        offered = self._enabled(upload.source_component_uuid)[0] == "GuiUploadButtonMessage"
        if not offered or (upload.size_bytes == 0) != (upload.part_count == 0) or self._upload is not None:
            return False
        self._upload = (upload, {}) if upload.part_count else None
        return True

    def _continues(self, part: FilePart) -> bool:
        """Whether this part belongs to the file: one file at a time, each part once, as many bytes as announced."""
        if self._upload is None:
            return False
        upload, lengths = self._upload
        named = (part.transfer_uuid, part.source_component_uuid) == (upload.transfer_uuid, upload.source_component_uuid)
        if not named or not 0 <= part.part_index < upload.part_count or part.part_index in lengths:
            return False
        missing, length = upload.size_bytes - sum(lengths.values()), len(part.content)
        last = len(lengths) + 1 == upload.part_count
        if not (length == missing if last else 0 < length < missing):
            return False
        lengths[part.part_index] = length
        if last:
            self._upload = None
        return True


def _is_within(value: object, props: Mapping[str, Any]) -> bool:
    return type(value) in (int, float) and bool(props["min"] <= value <= props["max"])


_VALUES: Mapping[str, Callable[[object, Mapping[str, Any]], bool]] = {
    "GuiButtonMessage": lambda value, props: value is True,
    "GuiCheckboxMessage": lambda value, props: type(value) is bool,
    "GuiDropdownMessage": lambda value, props: type(value) is str and value in props["options"],
    "GuiSliderMessage": _is_within,
    "GuiTextMessage": lambda value, props: type(value) is str and len(value) <= LONGEST_TEXT,
}
"""By kind of control: whether a control with these properties offers this value."""
