"""Several nodes in one process: what one gives and another takes goes from hand to hand."""

from collections import defaultdict, deque
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.publisher import Publisher


class SharedPublisher:
    """
    A publisher whose messages the other nodes of the process get as they are, uncopied.

    DDS gets them too where anybody outside listens, or may come later and still want the last:
    after those here, who may be on the way to an attitude.
    """

    def __init__(self, publisher: Publisher, composition: 'Composition', durable: bool) -> None:
        self._publisher = publisher
        self._composition = composition
        self._durable = durable
        self._topic = publisher.topic_name

    def publish(self, message: Any) -> None:
        """Give a message, which nobody may change from now on."""
        outside = self._durable or self._publisher.get_subscription_count()
        if self._composition.takers(self._topic):
            self._composition.hand_over(
                self._topic, message, self._publisher.publish if outside else None)
        elif outside:
            self._publisher.publish(message)

    def get_subscription_count(self) -> int:
        """Return how many take this topic, here and elsewhere."""
        return (self._composition.takers(self._topic)
                + self._publisher.get_subscription_count())


class Composition:
    """
    Who gives and who takes which topic in this process; all of it runs in one thread.

    A topic that a node of the process gives is taken from that node alone. As messages go
    through a queue, a callback is through before what it gave is taken, as over DDS. What
    nobody on the way to an attitude waits for has a queue of its own, and comes last.
    """

    def __init__(self) -> None:
        self._given: set[str] = set()
        self._callbacks: dict[str, list[tuple[Callable[[Any], None], bool]]] = defaultdict(list)
        self._subscribe: dict[str, list[Callable[[], None]]] | None = defaultdict(list)
        self._first: deque[Callable[[], None]] = deque()
        self._last: deque[Callable[[], None]] = deque()
        self._at_work = False

    def give(self, publisher: Publisher, durable: bool) -> SharedPublisher:
        """Return what publishes a topic here and on DDS."""
        self._given.add(publisher.topic_name)
        return SharedPublisher(publisher, self, durable)

    def take(self, topic: str, callback: Callable[[Any], None],
             subscribe: Callable[[], None], last: bool = False) -> None:
        """Take a topic from the node that gives it, or call subscribe() where there is none."""
        self._callbacks[topic].append((callback, last))
        if self._subscribe is not None:
            self._subscribe[topic].append(subscribe)
        elif topic not in self._given:
            subscribe()

    def connect(self) -> None:
        """Subscribe to what no node gives, once all of them are there."""
        waiting, self._subscribe = self._subscribe, None
        for topic, subscriptions in (waiting or {}).items():
            if topic not in self._given:
                for subscribe in subscriptions:
                    subscribe()

    def takers(self, topic: str) -> int:
        """Return how many callbacks of this process take a topic."""
        return len(self._callbacks.get(topic, ()))

    def hand_over(self, topic: str, message: Any,
                  publish: Callable[[Any], None] | None) -> None:
        """Call all who take a topic, after those whose messages came before, then publish."""
        for callback, last in self._callbacks[topic]:
            (self._last if last else self._first).append(partial(callback, message))
        if publish is not None:
            self._last.append(partial(publish, message))
        self._work()

    def afterwards(self, work: Callable[[], None]) -> None:
        """Do work once nothing is left that an attitude waits for."""
        self._last.append(work)
        self._work()

    def _work(self) -> None:
        if self._at_work:
            return
        self._at_work = True
        try:
            while waiting := self._first or self._last:
                waiting.popleft()()
        finally:
            self._at_work = False
            self._first.clear()
            self._last.clear()
