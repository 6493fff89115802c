"""Stand-ins for dynamic_reconfigure servers, as the reconfigure client sees them."""

from concurrent.futures import Future


class RunningServer:
    """A dynamic_reconfigure server that takes every request."""

    def __init__(self, values):
        self.name = "server"
        self.values = dict(values)
        self.call = Future()
        self.call.set_result("")

    def bounded(self, values):
        return dict(values)

    def has_set(self, request):
        return all(self.values[name] == value for name, value in request.items())

    def begin_call(self, request):
        self.values.update(request)

    def value_of(self, target):
        return self.values[target.name]

    def largest_of(self, target):
        return 1e6


def running_servers(space, settings):
    """Return {name: RunningServer} of a space's servers with the values of settings."""
    return {server: RunningServer(settings[server]) for server in space.servers}
