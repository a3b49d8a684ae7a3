"""Section 4 of Cong et al. 2008: GA, PSO and DE on all parameters, Tables 6 and 7."""
