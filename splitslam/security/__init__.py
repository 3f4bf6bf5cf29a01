"""Who is who in a fleet: names, certificates, tokens. Threat model and set-up: docs/security.md."""
