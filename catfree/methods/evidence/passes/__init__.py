"""The passes of the evidence method; each maps an `EvidenceState` to the next."""
