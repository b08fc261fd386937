"""pdhe: reproducible studies of hydrogen-assisted fracture."""
