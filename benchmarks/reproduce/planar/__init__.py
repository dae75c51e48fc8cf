"""Pull against push message passing on an articulated figure in a cluttered picture (Desingh et al. 2018)."""
