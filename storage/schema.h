/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The SQL of schema/NNN_*.sql, built into the program: schema n takes a store from version n-1 to
 * version n. */
#ifndef GSN_STORAGE_SCHEMA_H
#define GSN_STORAGE_SCHEMA_H

extern const char gsn_schema_001[];
extern const char gsn_schema_002[];
extern const char gsn_schema_003[];
extern const char gsn_schema_004[];
extern const char gsn_schema_005[];
extern const char gsn_schema_006[];
extern const char gsn_schema_007[];
extern const char gsn_schema_008[];
extern const char gsn_schema_009[];

#endif
