"""Boxes as measurements of where people stand: likelihoods, views, visibility."""
