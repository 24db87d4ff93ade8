"""The paper's method, stage by stage."""
