"""The paper's study: its four examples, its claims, its figures, and tables of them."""
