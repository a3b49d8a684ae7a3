"""Section 3 of Cong et al. 2008: sensor zeros and link lengths by fmincon, Tables 2 to 4."""
