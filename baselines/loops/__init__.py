"""Linear loops of the controllers: laws, arms behind their drives, margins, and the margins asked of tuned gains."""
