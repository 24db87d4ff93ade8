"""What is reported, and how uncertain it is."""
