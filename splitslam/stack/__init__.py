"""The replicated stack as plain processes, without containers: PostgreSQL, Envoy, replicas of the map service.

`Stack` starts all of it on loopback; every part can be stopped, killed, frozen and started again.
"""

from splitslam.stack.envoy import EnvoyProxy
from splitslam.stack.postgres import PostgresServer
from splitslam.stack.process import StackError, check_stack_installed
from splitslam.stack.replica import Replica
from splitslam.stack.stack import Stack

__all__ = ["EnvoyProxy", "PostgresServer", "Replica", "Stack", "StackError", "check_stack_installed"]
