// Stands in for gattlib, by which setup joints of an Si read their potentiometers over Bluetooth:
// no connection is ever made. Simulated setup joints ask for none.
#pragma once
#include <cstddef>
struct gatt_connection_t {};
struct uuid_t {};
enum { GATTLIB_SUCCESS = 0, GATTLIB_ERROR = 1 };
enum { GATTLIB_CONNECTION_OPTIONS_LEGACY_DEFAULT = 0 };
inline int gattlib_string_to_uuid(const char *, size_t, uuid_t *) { return GATTLIB_ERROR; }
inline gatt_connection_t * gattlib_connect(void *, const char *, unsigned long) { return nullptr; }
inline int gattlib_read_char_by_uuid(gatt_connection_t *, uuid_t *, void **, size_t *) { return GATTLIB_ERROR; }
inline void gattlib_characteristic_free_value(void *) {}
