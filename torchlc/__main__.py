"""``python -m torchlc``."""

from torchlc.cli.commands import main

if __name__ == "__main__":
    main()
