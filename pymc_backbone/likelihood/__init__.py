"""Where measured and simulated backbones meet: densities over a population, errors of specimens, the PyTensor Op."""
