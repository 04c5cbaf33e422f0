"""Floor plans and hand-made graphs: reading them into buildings, correcting and drawing them."""
