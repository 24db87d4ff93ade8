"""Published weights by name: a table, the files on this machine, the adapters that run them."""
