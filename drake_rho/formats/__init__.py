"""Export of plans, flights and simulations to the file formats of other programs."""
