"""Ask the Vulkan loader which devices there are: GGUI on a software driver is slower than the rasteriser."""

import ctypes
import ctypes.util
from functools import lru_cache

_CPU = 4  # VK_PHYSICAL_DEVICE_TYPE_CPU
_INSTANCE_CREATE_INFO = 1  # VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO
_LIBRARIES = ("libvulkan.so.1", "vulkan-1.dll", "libvulkan.1.dylib", "libMoltenVK.dylib")


class _CreateInfo(ctypes.Structure):
    """VkInstanceCreateInfo."""

    _fields_ = (
        ("type", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("application", ctypes.c_void_p),
        ("layer_count", ctypes.c_uint32),
        ("layers", ctypes.c_void_p),
        ("extension_count", ctypes.c_uint32),
        ("extensions", ctypes.c_void_p),
    )


class _Properties(ctypes.Structure):
    """The beginning of VkPhysicalDeviceProperties, with room for the rest, which is less than 1 kB."""

    _fields_ = (
        ("api", ctypes.c_uint32),
        ("driver", ctypes.c_uint32),
        ("vendor", ctypes.c_uint32),
        ("device", ctypes.c_uint32),
        ("kind", ctypes.c_int32),
        ("name", ctypes.c_char * 256),
        ("rest", ctypes.c_uint8 * 4096),
    )


@lru_cache(maxsize=1)
def devices() -> tuple[tuple[str, bool], ...]:
    """Name of each Vulkan device, and whether it is software; empty without a Vulkan loader or a driver."""
    vulkan = _loader()
    if vulkan is None:
        return ()
    instance = ctypes.c_void_p()
    given = _CreateInfo(type=_INSTANCE_CREATE_INFO)
    if vulkan.vkCreateInstance(ctypes.byref(given), None, ctypes.byref(instance)) != 0:
        return ()
    try:
        count = ctypes.c_uint32()
        vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), None)
        handles = (ctypes.c_void_p * count.value)()
        vulkan.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
        found = []
        for handle in handles:
            properties = _Properties()
            vulkan.vkGetPhysicalDeviceProperties(ctypes.c_void_p(handle), ctypes.byref(properties))
            found.append((properties.name.decode(errors="replace"), properties.kind == _CPU))
        return tuple(found)
    finally:
        vulkan.vkDestroyInstance(instance, None)


def software_driver() -> str | None:
    """Name of the software driver if there are Vulkan devices and none of them is a GPU, else None."""
    found = devices()
    if not found or not all(software for _, software in found):
        return None
    return found[0][0]


def _loader() -> ctypes.CDLL | None:
    for name in (*_LIBRARIES, ctypes.util.find_library("vulkan")):
        try:
            if name:
                return ctypes.CDLL(name)
        except OSError:
            continue
    return None
