"""Contact of reduced bodies: surface compliance and projected Gauss-Seidel contact."""
