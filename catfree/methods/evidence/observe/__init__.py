"""Boxes as measurements of people's positions: likelihoods, views, visibility."""
