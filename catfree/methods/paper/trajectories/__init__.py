"""Tracks from accepted positions: linking and extension."""

from catfree.methods.paper.trajectories._build_trajectories import (
    build_trajectories as build_trajectories,
)
from catfree.methods.paper.trajectories._extend import extend_tracks as extend_tracks
from catfree.methods.paper.trajectories._link import (
    Positions as Positions,
    drop_short as drop_short,
    link_positions as link_positions,
    position_appearance as position_appearance,
)
from catfree.methods.paper.trajectories._velocity import (
    difference_velocities as difference_velocities,
)
