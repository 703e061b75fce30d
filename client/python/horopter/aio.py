"""The client for asyncio."""
from __future__ import annotations

import asyncio
import time
from typing import Any, Callable, Iterable, List, Optional, Sequence

import grpc
import grpc.aio

from horopter.v1 import catalog_pb2, catalog_pb2_grpc, recognition_pb2_grpc

from . import _requests
from ._requests import Hints
from .errors import Busy, from_rpc
from .images import ImageLike
from .security import Security, open_channel
from .types import CatalogObject, Gripper, LookAlike, Reference, Scene, resource_name


class AsyncClient:
    """As `Client`, for one event loop. Cancelling the task cancels the call.

    >>> async def parts():                                                           # doctest: +SKIP
    ...     async with AsyncClient("localhost:50051") as client:
    ...         return (await client.recognize(["0.png", "1.png"])).objects
    """

    def __init__(self, address: str = "localhost:50051", deadline_s: float = 600.0, retries: int = 5,
                 security: Security = Security()):
        self.deadline_s = deadline_s
        self.retries = retries
        self.security = security
        self._channel = open_channel(grpc.aio, address, security)
        self._catalog = catalog_pb2_grpc.CatalogServiceStub(self._channel)
        self._recognition = recognition_pb2_grpc.RecognitionServiceStub(self._channel)

    async def __aenter__(self) -> "AsyncClient":
        return self

    async def __aexit__(self, *_: Any) -> None:
        await self.close()

    async def close(self) -> None:
        await self._channel.close()

    async def _call(self, method: Callable[..., Any], request: Any, deadline_s: Optional[float]) -> Any:
        end = time.monotonic() + (self.deadline_s if deadline_s is None else deadline_s)
        for attempt in range(self.retries + 1):
            try:
                return await method(request, timeout=max(0.0, end - time.monotonic()), metadata=self.security.metadata())
            except grpc.aio.AioRpcError as rpc_error:
                error = from_rpc(rpc_error)
            if not isinstance(error, Busy) or attempt == self.retries or error.retry_after_s is None:
                raise error
            if time.monotonic() + error.retry_after_s >= end:
                raise error
            await asyncio.sleep(error.retry_after_s)
        raise AssertionError("unreachable")

    async def recognize(self, images: Iterable[ImageLike], hints: Hints = None,
                        candidates: Optional[Iterable[str]] = None, reference: Optional[Reference] = None,
                        deadline_s: Optional[float] = None, gripper: Optional[Gripper] = None, min_score: float = 0.0,
                        full: bool = True, overlay: Optional[str] = None, explain: Optional[str] = None,
                        station: Optional[str] = None, station_cameras: Optional[Sequence[str]] = None,
                        cropped: bool = False, ignore_exif: bool = False) -> Scene:
        """As Client.recognize."""
        request = _requests.recognize_request(images, hints, candidates, reference, gripper, min_score, full, overlay,
                                              explain, station, station_cameras, cropped, ignore_exif)
        return Scene.from_proto(await self._call(self._recognition.RecognizeScene, request, deadline_s))

    async def list_objects(self, deadline_s: Optional[float] = None) -> List[CatalogObject]:
        """As Client.list_objects."""
        objects: List[CatalogObject] = []
        request = catalog_pb2.ListObjectsRequest(page_size=200)
        while True:
            answer = await self._call(self._catalog.ListObjects, request, deadline_s)
            objects.extend(CatalogObject.from_proto(o) for o in answer.objects)
            if not answer.next_page_token:
                return objects
            request.page_token = answer.next_page_token

    async def get_object(self, object_id: str, full: bool = False, deadline_s: Optional[float] = None) -> CatalogObject:
        """As Client.get_object."""
        request = _requests.get_request(object_id, full)
        return CatalogObject.from_proto(await self._call(self._catalog.GetObject, request, deadline_s))

    async def delete_object(self, object_id: str, deadline_s: Optional[float] = None) -> None:
        request = catalog_pb2.DeleteObjectRequest(name=resource_name(object_id))
        await self._call(self._catalog.DeleteObject, request, deadline_s)

    async def look_alikes(self, object_id: str, deadline_s: Optional[float] = None) -> List[LookAlike]:
        """As Client.look_alikes."""
        request = catalog_pb2.ListLookAlikesRequest(name=resource_name(object_id))
        answer = await self._call(self._catalog.ListLookAlikes, request, deadline_s)
        return [LookAlike.from_proto(a) for a in answer.look_alikes]
