"""The two ways a job ends early that are not bugs."""


class BadInput(Exception):
    """Something the user gave cannot be used.

    The message is one line: which file or object, what is wrong, what to do.  The command line
    prints it and exits with 3; operators report it.
    """


class Cancelled(Exception):
    """The user stopped the job.  What was found until then may travel in ``partial``."""

    def __init__(self, partial: object | None = None) -> None:
        super().__init__("cancelled")
        self.partial = partial
