"""What every other room uses and what needs no mechanics: errors, files, parameters, processes, figures."""
