"""Pictures of a world: a textured square among houses, furniture, shadows, people who walk."""

from catfree.synthetic.render.stage import street_furniture as street_furniture
from catfree.synthetic.render.video import (
    make_demo_world as make_demo_world,
    render_videos as render_videos,
)
