"""The command line as tests call it."""

from typer.testing import CliRunner

from docdepth.cli import app
from docdepth.errors import DocDepthError


def cli(*arguments):
    """Run the command line as main() does."""
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    if isinstance(result.exception, DocDepthError):
        result.exit_code = 2
    elif result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result
