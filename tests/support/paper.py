"""The paper's own feel: for tests of its equations and its experiment."""

from hapnet.params import Params

PAPER = Params(rendering="paper")
