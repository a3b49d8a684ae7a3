"""The gap before and after, on fitting rows and on poses that no fit has seen, over what noise alone leaves."""
