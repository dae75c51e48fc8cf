"""Beliefs over the poses and joints of articulated objects, from depth scans, by pull message passing for
nonparametric belief propagation."""
