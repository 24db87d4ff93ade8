"""The passes of the evidence method, in their order: each maps an `EvidenceState` to the next."""
