"""Select the stars to store on board and assess the selection."""
