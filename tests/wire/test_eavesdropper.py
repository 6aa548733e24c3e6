"""In real time: two processes that encrypt, over udp, and a third that hears all that they send."""

from pathlib import Path

import pytest
import zenoh

from hapnet.errors import BadMessage
from hapnet.transport.config import free_address
from hapnet.wire.encryption import read
from hapnet.wire.messages import Bye, Encrypted, Hello, Refuse, Welcome, decode
from tests.conftest import mostly_slow
from tests.support.processes import HAPNET, Program, read_json


class Listener:
    """Hears every key below ``hapnet/``."""

    def __init__(self, address: str) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{address}"]')
        self._session = zenoh.open(config)
        self._hears = self._session.declare_subscriber("hapnet/**", zenoh.handlers.FifoChannel(10_000))

    def heard(self) -> list[tuple[str, bytes]]:
        found = []
        while (sample := self._hears.try_recv()) is not None:
            found.append((str(sample.key_expr).rpartition("/")[2], sample.payload.to_bytes()))
        return found

    def close(self) -> None:
        self._session.close()


@pytest.mark.parametrize("has_word", mostly_slow([True, False], 0, 1))
def test_who_listens_reads_nothing_but_who_is_there(has_word: bool, tmp_path: Path) -> None:
    address = free_address("tcp")
    (word := tmp_path / "word").write_text("correct horse\n", "utf-8")
    word.chmod(0o600)
    flags = [
        "--encrypt",
        "--duration",
        3,
        "--once",
        "--set",
        "operator_model.wait_s=0",
        *(["--secret-file", word] if has_word else []),
    ]
    with (
        Program("world", "-l", address, *flags, "--json", tmp_path / "world.json", command=HAPNET) as world,
        Program("device", "-e", address, *flags, "--json", tmp_path / "device.json") as device,
    ):
        world.until_line("waiting for the device")
        listener = Listener(address)
        for side in (world, device):
            side.end()
        heard = listener.heard()
        listener.close()
    kinds = set()
    for key, data in heard:
        if not data:
            continue  # keeps a key alive
        if key == "telemetry":
            assert read(data) is not None, data
            kinds.add("telemetry")
            continue
        try:
            kinds.add(type(decode(data)).__name__)
        except BadMessage as error:
            pytest.fail(f"{key}: {error} in {data.hex()}")
    plain = {kind.__name__ for kind in (Hello, Welcome, Refuse, Bye)}
    assert Encrypted.__name__ in kinds
    assert kinds - {Encrypted.__name__} - plain == ({"telemetry"} if has_word else set())
    summary = read_json(tmp_path / "device.json")
    assert summary["verdict"]["passive"], summary["verdict"]
    assert summary["device"]["acked_nJ"] + summary["device"]["credited_nJ"] > 0, summary["device"]
    # "unpaired": whoever proves its key first sends a little before the other side has paired
    assert set(summary["device"]["dropped"]) <= {"closed", "unpaired"}
