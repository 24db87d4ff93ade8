"""Boxes and a scene in, people on the ground out: the two methods and what to expect of them."""

from catfree.methods._localize import localize as localize
