"""From files to cycles to backbones at levels, each value with its error; knows nothing of simulation."""
