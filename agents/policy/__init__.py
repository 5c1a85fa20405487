"""Policies that act: network, bundle of files, card."""
