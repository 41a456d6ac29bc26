"""The paper's study: its four examples, six claims and sixteen figures, and tables of them."""
