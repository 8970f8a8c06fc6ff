"""Pairs of a facet and a direction: their angles and weights, and light that goes from facet to facet."""
