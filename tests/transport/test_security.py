"""Flags and files of security: what fits, what is refused, and what is warned of."""

import json
import shutil
import signal
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from examples.secure.make_certificates import issue, save
from hapnet import cli
from hapnet.errors import InvalidParameter
from hapnet.transport.config import ZenohSettings, free_address, local_address, proof_of, zenoh_config, zenoh_warnings
from hapnet.transport.router import routed
from hapnet.transport.security import Security, is_exposed
from tests.support.processes import started
from tests.support.secured import TLS, USRPWD, shows, users as users
from tests.support.transports import own, value


def with_file(security: Security, field: str, path: Path | None) -> Security:
    values = {name: getattr(security, name) for name in Security.__dataclass_fields__}
    return Security(**{**values, field: path})


# Flags


def bad(security: Security, *says: str) -> None:
    with pytest.raises(InvalidParameter) as raised:
        security.check()
    line = str(raised.value)
    assert "\n" not in line
    for words in says:
        assert words in line


def test_a_right_pair_is_right(certificates: Path, users: Path) -> None:
    replace(own(certificates, "world", mutual=True), users=users).check()
    replace(own(certificates, "alice"), user="alice", password="secret").check()


@pytest.mark.parametrize("field", ["tls_ca", "tls_cert", "tls_key", "password_file", "users"])
def test_a_file_that_is_not_there_or_not_text_is_named(field: str, certificates: Path, tmp_path: Path) -> None:
    right = replace(own(certificates, "alice"), user="alice", password="secret")
    flag = "--" + field.replace("_", "-")
    bad(with_file(right, field, tmp_path / "no.pem"), f"{flag} is ", "no.pem", "can be read (No such file")
    bad(with_file(right, field, tmp_path), f"{flag} is ", "can be read (Is a directory)")
    (tmp_path / "der").write_bytes(b"\x30\x82\xff\xfe")
    bad(with_file(right, field, tmp_path / "der"), f"{flag} is ", "not text")


def test_files_that_do_not_go_together(certificates: Path) -> None:
    right = own(certificates, "alice")
    bad(replace(right, tls_key=None), "--tls-cert ", "it needs its key, --tls-key FILE")
    bad(replace(right, tls_cert=None), "--tls-key ", "it needs its certificate, --tls-cert FILE")
    bad(replace(right, mutual_tls=True, tls_ca=None), "--mutual-tls", "--tls-ca")
    bad(Security(tls_ca=right.tls_ca, mutual_tls=True), "--mutual-tls", "--tls-cert")
    bad(replace(right, tls_key=certificates / "bob.key"), "--tls-key ", "it is not the key of ", "alice.pem")


def test_files_that_are_something_else(certificates: Path, tmp_path: Path) -> None:
    right = own(certificates, "alice")
    for field in ("tls_ca", "tls_cert"):
        flag = "--" + field.replace("_", "-")
        bad(with_file(right, field, certificates / "alice.key"), f"{flag} is ", "a certificate in PEM")
    bad(replace(right, tls_key=right.tls_cert), "--tls-key ", "it is not a private key in PEM without a passphrase")
    locked = tmp_path / "locked.key"
    command = ["openssl", "ec", "-in", str(right.tls_key), "-aes256", "-passout", "pass:abcd", "-out", str(locked)]
    if shutil.which("openssl"):
        subprocess.run(command, check=True, capture_output=True)
        bad(replace(right, tls_key=locked), "--tls-key ", "without a passphrase")


def test_a_certificate_that_has_expired(tmp_path: Path) -> None:
    authority = issue("authority", [], 1.0)
    save(tmp_path, "ca", authority)
    save(tmp_path, "alice", issue("alice", ["alice"], -0.001, authority))
    bad(own(tmp_path, "alice"), "--tls-cert ", "alice.pem", "the certificate has expired")


def test_users_and_passwords(users: Path, tmp_path: Path) -> None:
    bad(Security(user="alice"), "--user alice: it needs its password", "--password-file FILE", "HAPNET_PASSWORD")
    bad(Security(password_file=users), "--password-file ", "--user NAME")
    bad(Security(user="a:b", password="x"), "--user is 'a:b'", "without spaces and colons")
    empty = tmp_path / "empty"
    empty.write_text("\n", "utf-8")
    bad(Security(user="alice", password_file=empty), "--user alice: it needs its password", "--password-file")
    Security(password="not used without a user").check()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "it is empty; write lines user:password"),
        ("alice:secret\nbob\n", "line 2 is not user:password"),
        ("alice:secret\n\nbob:b\n", "line 2 is not user:password"),
        ("# alice:secret\n", "line 1 is not user:password"),
        ("alice:\n", "line 1 is not user:password"),
        (":secret\n", "line 1 is not user:password"),
        ("alice:secret\nalice:other\n", "line 2 names a user again"),
    ],
)
def test_a_users_file_that_is_malformed(text: str, says: str, users: Path) -> None:
    users.write_text(text, "utf-8")
    bad(Security(users=users), "--users ", says)
    with pytest.raises(InvalidParameter) as raised:
        Security(users=users).check()
    assert "secret" not in str(raised.value)  # nor any other line of it


def test_a_password_is_not_shown() -> None:
    assert "hush" not in repr(ZenohSettings(security=Security(user="alice", password="hush")))


# Zenoh's configuration


def test_flags_win_over_the_file_and_cfg_is_last(certificates: Path, users: Path, tmp_path: Path) -> None:
    file = tmp_path / "z.json5"
    tls = {"root_ca_certificate_base64": "QUFB", "listen_certificate": "other.pem", "so_sndbuf": 4096}
    auth = {"usrpwd": {"dictionary_file": "other"}}
    file.write_text(json.dumps({"transport": {"link": {"tls": tls}, "auth": auth}}), "utf-8")
    world = own(certificates, "world", mutual=True)
    settings = ZenohSettings(
        listen=("tls/127.0.0.1:1",),
        config=str(file),
        cfg=(f"{USRPWD}/user:'cfg'",),
        security=replace(world, users=users),
    )
    assert value(settings, f"{TLS}/root_ca_certificate") == str(world.tls_ca)
    assert value(settings, f"{TLS}/root_ca_certificate_base64") is None
    assert value(settings, f"{TLS}/listen_certificate") == str(world.tls_cert)
    assert value(settings, f"{TLS}/listen_private_key") == str(world.tls_key)
    assert value(settings, f"{TLS}/enable_mtls") is True
    assert value(settings, f"{TLS}/so_sndbuf") == 4096
    assert value(settings, "transport/link/protocols") == ["tls", "quic"]
    assert value(settings, USRPWD) == {"user": "cfg", "password": None, "dictionary_file": str(users)}
    later = replace(settings, cfg=(f"{TLS}/listen_certificate:'cfg.pem'",))
    assert value(later, f"{TLS}/listen_certificate") == "cfg.pem"


def test_who_dials_shows_its_certificate_and_who_listens_asks_for_one_only_if_told(certificates: Path) -> None:
    dials = ZenohSettings(connect=("tls/127.0.0.1:1",), security=own(certificates, "alice"))
    assert value(dials, f"{TLS}/enable_mtls") is True
    listens = ZenohSettings(listen=("tls/127.0.0.1:1",), security=shows(certificates, "world"))
    assert value(listens, f"{TLS}/enable_mtls") is None


def test_a_password_file_goes_before_the_environment(tmp_path: Path) -> None:
    file = tmp_path / "password"
    file.write_text("from a file \n", "utf-8")
    security = Security(user="alice", password="from the environment", password_file=file)
    settings = ZenohSettings(connect=("tcp/127.0.0.1:1",), security=security)
    assert value(settings, f"{USRPWD}/password") == "from a file"
    assert value(replace(settings, security=replace(security, password_file=None)), f"{USRPWD}/password") == (
        "from the environment"
    )


def test_flags_that_do_not_fit_the_endpoints(certificates: Path, users: Path, tmp_path: Path) -> None:
    ca, alice = Security(tls_ca=certificates / "ca.pem"), Security(user="alice", password="secret")
    by_file = tmp_path / "z.json5"
    by_file.write_text('{listen: {endpoints: {peer: ["tls/127.0.0.1:1", "tcp/127.0.0.1:1"]}}}', "utf-8")
    group = 'connect/endpoints:[{strategy:"oneOf",locators:["udp/127.0.0.1:1"]}]'
    by_cfg = replace(own(certificates, "alice"), tls_ca=None)
    cases = (
        (ZenohSettings(connect=("tcp/127.0.0.1:1",), security=ca), "connect is 'tcp/127.0.0.1:1'; allowed: tls/"),
        (ZenohSettings(listen=("unixsock-stream//x",), security=ca), "listen is 'unixsock-stream//x'; allowed: tls/"),
        (ZenohSettings(config=str(by_file), security=own(certificates, "world")), "listen is 'tcp/127.0.0.1:1'"),
        (ZenohSettings(cfg=(group,), security=by_cfg), "connect is 'udp/127.0.0.1:1'; allowed: tls/ or quic/ ADDR"),
        (ZenohSettings(multicast_scouting=True, security=ca), "listen is 'tcp/127.0.0.1:0'; allowed: tls/"),
        (ZenohSettings(listen=("tls/127.0.0.1:1",)), "it needs a certificate: --tls-cert and --tls-key"),
        (ZenohSettings(listen=("quic/127.0.0.1:1",), security=ca), "it needs a certificate: --tls-cert"),
        (
            ZenohSettings(listen=("tls/127.0.0.1:1",), security=own(certificates, "world")),
            "a side that only listens checks certificates with --mutual-tls only",
        ),
        (
            ZenohSettings(connect=("tcp/127.0.0.1:1",), security=Security(users=users)),
            "it belongs to the side that listens",
        ),
        (ZenohSettings(listen=("tcp/127.0.0.1:1",), security=alice), "--user alice: it belongs to the side that dials"),
    )
    for settings, says in cases:
        with pytest.raises(InvalidParameter) as raised:
            zenoh_config(settings)
        assert says in str(raised.value)
    zenoh_config(ZenohSettings(listen=("tls/127.0.0.1:1",), cfg=(f"{TLS}/listen_certificate_base64:'QUFB'",)))
    zenoh_config(ZenohSettings(multicast_scouting=True, security=replace(alice, users=users)))


# Warnings


@pytest.mark.parametrize(
    ("endpoint", "exposed"),
    [
        ("tcp/0.0.0.0:7447", True),
        ("tcp/[::]:0", True),
        ("udp/192.168.0.2:7447?rel=0", True),
        ("ws/example.org:80#iface=eth0", True),
        ("tcp/127.0.0.1:7447", False),
        ("udp/127.8.8.8:7447", False),
        ("tcp/[::1]:7447", False),
        ("ws/localhost:7447?prio=1-3", False),
        ("tls/0.0.0.0:7447", False),
        ("quic/[::]:7447?rel=0", False),
        ("unixsock-stream//tmp/socket", False),
        ("serial//dev/ttyUSB0", False),
        ("new-protocol/somewhere", True),
    ],
)
def test_what_is_exposed(endpoint: str, exposed: bool) -> None:
    assert is_exposed(endpoint) is exposed


def test_listening_without_a_word_or_encryption_is_warned_of_in_one_line(tmp_path: Path) -> None:
    file = tmp_path / "z.json5"
    file.write_text('{listen: {endpoints: ["tcp/0.0.0.0:1", "udp/127.0.0.1:1", "ws/[::]:2"]}}', "utf-8")
    (warning,) = zenoh_warnings(ZenohSettings(config=str(file)))
    assert warning.startswith("listening on tcp/0.0.0.0:1, ws/[::]:2 without --secret-file: ")
    encrypting = Security(encrypt=True)
    assert zenoh_warnings(ZenohSettings(config=str(file), security=encrypting)) == (warning,)
    (word := tmp_path / "word").write_text("correct horse\n", "utf-8")
    word.chmod(0o600)
    (warning,) = zenoh_warnings(ZenohSettings(config=str(file), security=Security(secret_file=word)))
    assert warning.startswith("listening on tcp/0.0.0.0:1, ws/[::]:2 without --encrypt: ")
    assert zenoh_warnings(ZenohSettings(config=str(file), security=replace(encrypting, secret_file=word))) == ()
    assert zenoh_warnings(ZenohSettings(multicast_scouting=True)) == ()
    assert zenoh_warnings(ZenohSettings(connect=("tcp/192.0.2.1:1",))) == ()


def test_secrets_that_others_can_read_are_warned_of(certificates: Path, users: Path, tmp_path: Path) -> None:
    world = replace(own(certificates, "world", mutual=True), users=users)
    settings = ZenohSettings(listen=("tls/0.0.0.0:1",), security=world)
    assert zenoh_warnings(settings) == ()
    key = tmp_path / "world.key"
    shutil.copy(certificates / "world.key", key)
    for mode, file, flag in ((0o640, key, "--tls-key"), (0o604, users, "--users")):
        file.chmod(mode)
        security = replace(world, tls_key=key)
        assert zenoh_warnings(replace(settings, security=security)) == (
            f"{flag} {file} can be read by others: chmod 600 {file}",
        )
        file.chmod(0o600)


def test_a_world_warns_once_and_first() -> None:
    address = free_address().replace("127.0.0.1", "0.0.0.0")
    with started("world", "-l", address) as world:
        world.until_line("waiting for the device")
        world.process.send_signal(signal.SIGTERM)
        code, stdout, stderr = world.end()
    assert (code, stderr) == (143, "")
    assert stdout.startswith(f"warning: listening on {address} without --secret-file: ")
    assert stdout.count("warning") == 1


@pytest.mark.parametrize(
    ("command", "flag"),
    [
        (command, flag)
        for command in ("device", "world", "doctor")
        for flag in ("--tls-ca", "--tls-key", "--password-file", "--users")
        if (command, flag) != ("doctor", "--users")
    ],
)
def test_a_bad_flag_is_one_line_and_exit_code_2(
    command: str, flag: str, certificates: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    side = "-l" if command == "world" else "-e"
    beside = {"--tls-key": ["--tls-cert", str(certificates / "alice.pem")], "--password-file": ["--user", "alice"]}
    assert cli.main([command, side, "tls/127.0.0.1:1", flag, "no.pem", *beside.get(flag, [])]) == 2
    out, err = capsys.readouterr()
    assert not out
    assert err == f"hapnet: {flag} is 'no.pem'; allowed: a file that can be read (No such file or directory)\n"


def test_a_password_comes_from_the_environment_and_is_nowhere_on_the_command_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    argv = ["world", "-l", "tcp/127.0.0.1:1", "--user", "alice"]
    assert cli.main(argv) == 2
    assert "HAPNET_PASSWORD" in capsys.readouterr().err
    monkeypatch.setenv("HAPNET_PASSWORD", "secret")
    assert cli.main(argv) == 2
    assert "it belongs to the side that dials" in capsys.readouterr().err  # the password was found
    assert cli.main([*argv, "--password", "secret"]) == 2
    assert "No such option" in capsys.readouterr().err


def test_what_proves_who_is_on_the_links(certificates: Path, users: Path) -> None:
    """Certificates where each link asks both ends for one, or for a password; a socket of this machine; else nobody."""
    world, alice = own(certificates, "world", mutual=True), own(certificates, "alice")
    listens, dials = ("tls/127.0.0.1:1",), ("tls/127.0.0.1:1",)
    assert proof_of(ZenohSettings(listen=listens, security=world)) == "certificate"
    assert proof_of(ZenohSettings(connect=dials, security=alice)) == "certificate"
    one_sided = replace(own(certificates, "world"), tls_ca=None)
    assert proof_of(ZenohSettings(listen=listens, security=one_sided)) is None
    assert proof_of(ZenohSettings(listen=listens, security=replace(one_sided, users=users))) == "certificate"
    assert proof_of(ZenohSettings(listen=("tcp/127.0.0.1:1",), security=Security(users=users))) is None
    assert proof_of(ZenohSettings(listen=("unixsock-stream//tmp/link",))) == "socket"
    for open_to_all in (("tcp/127.0.0.1:1",), ("unixsock-stream//tmp/link", "udp/127.0.0.1:1")):
        assert proof_of(ZenohSettings(listen=open_to_all)) is None
    assert proof_of(ZenohSettings(multicast_scouting=True)) is None


def test_a_router_proves_to_its_clients_no_more_than_its_own_links_do(tmp_path: Path) -> None:
    with routed(ZenohSettings(listen=(free_address(),))) as own:
        assert proof_of(own) is None
    with routed(ZenohSettings(listen=(local_address(str(tmp_path)),))) as own:
        assert proof_of(own) == "socket"
