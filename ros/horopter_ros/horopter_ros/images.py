"""Which images are of one moment. Nothing of ROS is needed to test this."""
from collections import deque


def nanoseconds(stamp):
    """Of a builtin_interfaces/Time."""
    return stamp.sec * 1_000_000_000 + stamp.nanosec


class ImageBuffer:
    """The last images of several topics. Not thread-safe.

    slop_s: images of one answer are at most so far apart (0: the newest of each topic, whenever they are of); max_age_s: older ones
    are not used (0: all are); depth: images that are kept of a topic.
    """

    # A clock that goes back by more than this was set, or a bag began again: what came before is of another time.
    BACK_NS = 1_000_000_000

    def __init__(self, topics, slop_s=0.0, max_age_s=0.0, depth=16):
        if slop_s < 0.0 or max_age_s < 0.0:
            raise ValueError("sync_slop, max_image_age: not negative")
        self._slop_ns, self._max_age_ns = int(slop_s * 1e9), int(max_age_s * 1e9)
        self._images = {topic: deque(maxlen=depth) for topic in topics}

    def add(self, topic, image):
        kept = self._images[topic]
        if kept and nanoseconds(image.header.stamp) < nanoseconds(kept[-1].header.stamp) - self.BACK_NS:
            kept.clear()
        kept.append(image)

    def of_one_moment(self, now_ns=None):
        """{topic: image}, in the order of the topics: of as many topics as have images together, the newest such. Topics without one
        (a gap, a camera that stands still) are left out. now_ns: of the clock that stamps images; None: ages are not looked at."""
        images = {topic: list(kept) for topic, kept in self._images.items()}
        if now_ns is not None and self._max_age_ns:
            images = {topic: [i for i in kept if nanoseconds(i.header.stamp) >= now_ns - self._max_age_ns]
                      for topic, kept in images.items()}
        if not self._slop_ns:
            return {topic: max(kept, key=lambda i: nanoseconds(i.header.stamp)) for topic, kept in images.items() if kept}
        best = {}
        # In the best set one image is the last one: all others are at most the slop before it.
        for last in sorted({nanoseconds(i.header.stamp) for kept in images.values() for i in kept}, reverse=True):
            found = {}
            for topic, kept in images.items():
                fitting = [i for i in kept if last - self._slop_ns <= nanoseconds(i.header.stamp) <= last]
                if fitting:
                    found[topic] = max(fitting, key=lambda i: nanoseconds(i.header.stamp))
            if len(found) > len(best):
                best = found
        return best

    def newest(self, topic):
        """The newest image of the topic; None: none has come in."""
        kept = self._images[topic]
        return max(kept, key=lambda i: nanoseconds(i.header.stamp)) if kept else None


class Collection:
    """Images of cameras that move, each with the pose of its camera at the time. Not thread-safe."""

    MOST = 32

    def __init__(self):
        self._views = []

    def add(self, topic, image, base_from_camera):
        """Raises ValueError: the image is there already, no pose, too many."""
        if base_from_camera is None:
            raise ValueError("%s: TF has no pose of %s at the time of the image" % (topic, image.header.frame_id))
        stamp = nanoseconds(image.header.stamp)
        if any(t == topic and nanoseconds(i.header.stamp) == stamp for t, i, _ in self._views):
            raise ValueError("%s: no image has come in since the last one that was taken" % topic)
        if len(self._views) >= self.MOST:
            raise ValueError("%d images are taken already" % self.MOST)
        self._views.append((topic, image, base_from_camera))

    def views(self):
        """[(topic, image, 4 x 4 pose of the camera in the base)], as they were taken."""
        return list(self._views)

    def clear(self):
        self._views = []
