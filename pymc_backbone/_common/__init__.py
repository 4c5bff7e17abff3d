"""What every folder may use: checks of arguments, words made safe, whole files, processes, compiled code on disk."""
