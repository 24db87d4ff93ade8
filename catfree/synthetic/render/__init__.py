"""Rendering of a world: a textured square with houses, furniture, shadows and walking people."""

from catfree.synthetic.render._render_videos import (
    make_demo_world as make_demo_world,
    render_videos as render_videos,
)
from catfree.synthetic.render._stage import street_furniture as street_furniture
