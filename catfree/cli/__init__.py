"""The command line."""

from catfree.cli._main import main as main
