"""The command line."""

from catfree.cli._commands import main as main
