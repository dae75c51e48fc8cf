"""The paper's experiments, and how they come out with this implementation."""
