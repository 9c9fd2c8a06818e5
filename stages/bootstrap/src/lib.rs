//! B retrainings to uncertainty maps and a fly-through.
