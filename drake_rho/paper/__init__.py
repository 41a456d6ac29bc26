"""The paper's study: four examples, six claims, sixteen figures, and tables."""
