"""What readers of files take: plain files, of bounded size and depth; each refusal is one line."""

import os
import struct
import time
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard

from hapnet import file_content
from hapnet.cli import main
from hapnet.errors import HapnetError, RecordingError
from hapnet.ext.solids.volume_file import read_volume
from hapnet.params import Params
from hapnet.recording import mcap_reader
from hapnet.recording.mcap import read_recording, save
from hapnet.recording.mcap_reader import Records
from hapnet.simulation.simulation import Simulation

MAGIC = b"\x89MCAP0\r\n"


def test_a_pipe_and_a_device_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path, tmp_path / "none", "a\0b"):
        with pytest.raises(OSError, match=r".") as refused:
            file_content.read_bytes(path, 10)
        assert refused.value.strerror
    (tmp_path / "long").write_bytes(bytes(11))
    with pytest.raises(OSError, match="allowed"):
        file_content.read_bytes(tmp_path / "long", 10)
    assert file_content.read_bytes(tmp_path / "long", 11) == bytes(11)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = " + "[" * 100_000, "nested"),
        ("x = " + "[" * 100_000 + "]" * 100_000, "nested"),
        ("x = " + "{a=" * 100_000 + "1" + "}" * 100_000, "nested"),
        ("[" + "a." * 100_000 + "a]", "dots"),
        ("a." * 60 + "a = 1", "nested"),
        ("dof = " + "9" * 5000, "digits"),
        ("dof = 0x" + "f" * 5000, "64 bits"),
        ("dof = 9223372036854775808", "64 bits"),
        (2 * ("[" + "a." * 1000 + "a]\n"), "twice (at line 2, column 2003)"),
    ],
    ids=range(9),
)
def test_toml_has_bounds(text: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (file := tmp_path / "params.toml").write_text(text)
    assert main(["simulate", "--params", str(file), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip()
    assert words in said
    assert said.count("\n") == 0
    assert len(said) < 500
    assert main(["sweep", str(file), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.strip().count("\n") == 0


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 100_000, "nan"])
def test_a_value_on_the_command_line_has_bounds_too(value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--set", f"dof={value}"]) == 2
    assert capsys.readouterr().err.strip().count("\n") == 0


# -- recordings --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recordings") / "honest.mcap"
    save(Simulation(Params().set({"duration_s": 0.3}), 1, kernel=False).run().recording, file)
    return file


def with_chunk(honest: Path, kind: str, data: bytes, claimed: int) -> Path:
    """The recording with another chunk before its own."""
    whole = honest.read_bytes()
    body = struct.pack("<QQQII", 0, 1, claimed, 0, len(kind)) + kind.encode() + struct.pack("<Q", len(data)) + data
    at = len(MAGIC)
    while whole[at] != 6:
        at += 9 + struct.unpack("<Q", whole[at + 1 : at + 9])[0]
    file = honest.with_name(f"{kind}-{claimed}.mcap")
    file.write_bytes(whole[:at] + b"\x06" + struct.pack("<Q", len(body)) + body + whole[at:])
    return file


@pytest.mark.parametrize("kind", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed", [None, 100, 1 << 20])
def test_a_chunk_that_unpacks_to_gigabytes_is_refused_unopened(honest: Path, kind: str, claimed: int | None) -> None:
    """Whether it says so or not. 64 MiB stand for more; 2 GiB are below, with zstd."""
    size = 64 << 20
    data = zstandard.compress(bytes(size)) if kind == "zstd" else lz4.frame.compress(bytes(size))
    file = with_chunk(honest, kind, data, size if claimed is None else claimed)
    if claimed is None:
        with pytest.raises(RecordingError, match=r"unpacks to .* allowed"):
            read_recording(file)
    else:
        found = read_recording(file)  # it says something else than it has: damage, and all else is read
        assert len(found.lost) == 1
        assert len(found.samples()) == len(read_recording(honest).samples())


def test_two_gigabytes_take_no_time(honest: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    packed = zstandard.ZstdCompressor(level=1).compressobj(size=1 << 31)
    data = b"".join(packed.compress(bytes(1 << 24)) for _ in range(128)) + packed.flush()
    file = with_chunk(honest, "zstd", data, 1 << 31)
    assert file.stat().st_size < 400_000
    began = time.process_time()
    assert main(["replay", str(file), "--out", str(tmp_path)]) == 2
    took = time.process_time() - began
    assert "unpacks to 2147483648" in (said := capsys.readouterr().err.strip())
    assert said.count("\n") == 0
    assert took < 10.0


def test_many_small_chunks_are_not_more_than_one(honest: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_reader, "AT_LEAST", 1000)
    monkeypatch.setattr(mcap_reader, "MOST_TIMES", 0.5)
    with pytest.raises(RecordingError, match="times the file's size in all"):
        list(Records(honest))


@pytest.mark.parametrize("time_ns", [1 << 63, (1 << 64) - 1, 1 << 62])
def test_a_time_beyond_all_clocks_is_refused(honest: Path, time_ns: int) -> None:
    whole = honest.read_bytes()
    at = len(MAGIC)
    while whole[at] != 6:
        at += 9 + struct.unpack("<Q", whole[at + 1 : at + 9])[0]
    body = whole[at + 9 : at + 9 + struct.unpack("<Q", whole[at + 1 : at + 9])[0]]
    inside = bytearray(lz4.frame.decompress(body[32 + 3 + 8 :]))
    k = 0
    while k < len(inside):
        length = struct.unpack_from("<Q", inside, k + 1)[0]
        if inside[k] == 5:
            struct.pack_into("<Q", inside, k + 9 + 6, time_ns)
        k += 9 + length
    file = with_chunk(honest, "", bytes(inside), len(inside))
    with pytest.raises(RecordingError, match="a time of"):
        read_recording(file)


# -- numpy -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["(10000000000000,)", "(4611686018427387904, 4, 4)", "(5, 5, 6)", "(-5, -5, 5)"])
@pytest.mark.parametrize("kind", ["<f8", "|O"])
def test_the_header_of_an_array_is_a_claim(tmp_path: Path, shape: str, kind: str) -> None:
    np.save(file := tmp_path / "array.npy", np.zeros((5, 5, 5)))
    data = file.read_bytes()
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    file.write_bytes(data[:10] + header.encode() + data[128:])
    with pytest.raises(HapnetError, match="announced"):
        read_volume(str(file), 1e-3, 1e-3, None)


@pytest.mark.parametrize("order", ["C", "F"])
def test_an_array_is_read_as_numpy_reads_it(tmp_path: Path, order: str) -> None:
    values = np.linalg.norm(np.mgrid[-2:3, -2:4, -2:5], axis=0) - 1.5
    np.save(file := tmp_path / "array.npy", np.asarray(values, "<f4", order=order))  # type: ignore[call-overload]
    found, _ = read_volume(str(file), 1e-3, 1e-3, None)
    assert np.array_equal(found, 1e-3 * np.load(file).astype(float))
