"""The constants of the evidence method live with all others in `catfree.settings`."""

from catfree.settings import EvidenceSettings as EvidenceSettings
