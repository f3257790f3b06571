"""From measured stiffness back to the spall, with its uncertainty. The public function is `difftrb.fit`."""
