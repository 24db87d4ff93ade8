"""The report page: its blocks, and the player of the plan beside the cameras' pictures."""
