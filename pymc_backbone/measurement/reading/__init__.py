"""Measured files of many formats read into records, or into backbones where those were measured."""
