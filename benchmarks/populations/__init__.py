"""What the size of a population costs or brings, method by method, on our problems and on others."""
