//! A simulated Hokuyo scanner.
