"""Tests of drake_rho."""
