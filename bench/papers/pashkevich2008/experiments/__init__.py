"""What the measured experiments of Pashkevich et al. 2008 support: the page docs/orthoglide-experiments.md."""
