"""Suturing: stitches through soft tissue, planned, executed and scored."""
