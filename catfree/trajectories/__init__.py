"""Accepted positions become tracks: link, extend."""

from catfree.trajectories.build import build_trajectories as build_trajectories
from catfree.trajectories.extend import extend_tracks as extend_tracks
from catfree.trajectories.link import (
    Positions as Positions,
    drop_short as drop_short,
    fill_gaps as fill_gaps,
    link_positions as link_positions,
    position_appearance as position_appearance,
)
