"""Published weights by name: a table, the files on this machine, the adapters that run them."""

from catfree.adapters.weights._fetch_weights import fetch_weights as fetch_weights
from catfree.adapters.weights._pretrained import pretrained as pretrained
from catfree.adapters.weights._weights_table import WEIGHTS as WEIGHTS, Weights as Weights
