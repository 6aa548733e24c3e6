import inspect
from dataclasses import dataclass
from typing import Annotated

import pytest
import typer

from netem.groups import Without, grouped

Delay = Annotated[str | None, typer.Option(help="Delay.")]


@dataclass(frozen=True)
class Link:
    delay: Delay = None
    loss: str = "0%"


@dataclass(frozen=True)
class Hand:
    mass: float = 0.5


Reported = list[tuple[int, Link, Hand, bool]]


def application(reported: Reported) -> typer.Typer:
    app = typer.Typer()

    @app.command()
    @grouped
    def both(*, seed: int = 3, link: Link, hand: Hand, quick: bool = False) -> int:
        """What it does."""
        reported.append((seed, link, hand, quick))
        return 7

    return app


def test_a_group_becomes_its_fields_in_its_place() -> None:
    @grouped
    def command(*, seed: int = 3, link: Link, quick: bool = False) -> int:
        """What it does."""
        return 0

    parameters = inspect.signature(command).parameters
    assert list(parameters) == ["seed", "delay", "loss", "quick"]
    assert [parameter.default for parameter in parameters.values()] == [3, None, "0%", False]
    assert parameters["delay"].annotation == Delay
    assert (command.__name__, command.__doc__) == ("command", "What it does.")


def test_the_command_gets_its_groups_built() -> None:
    reported: Reported = []
    argv = ["--loss", "2%", "--mass", "0.1", "--quick", "--seed", "4"]
    assert application(reported)(args=argv, standalone_mode=False) == 7
    assert application(reported)(args=[], standalone_mode=False) == 7
    assert reported == [(4, Link(None, "2%"), Hand(0.1), True), (3, Link(), Hand(), False)]


def test_what_a_command_goes_without_keeps_its_default() -> None:
    @grouped
    def command(*, link: Annotated[Link, Without("loss")]) -> int:
        assert link == Link("4ms", "0%")
        return 5

    assert list(inspect.signature(command).parameters) == ["delay"]
    assert command(delay="4ms") == 5


def test_a_field_that_is_not_there_cannot_be_left_out() -> None:
    def command(*, link: Annotated[Link, Without("rate", "loss")]) -> int:
        return 0

    with pytest.raises(TypeError, match="Link has no rate"):
        grouped(command)


def test_two_flags_of_one_name_are_refused() -> None:
    def command(*, delay: str = "", link: Link) -> int:
        return 0

    with pytest.raises(ValueError, match="delay"):
        grouped(command)
