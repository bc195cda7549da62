/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/power/disk.h"

#include <fcntl.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "pipeline/core/mem.h"

enum { SECTOR = 512 };

/* One change of one file or directory. */
struct change {
    enum power_op op; /* of a directory: CREATE (a name for node), UNLINK, SYNC_DIR */
    size_t step;
    size_t node;
};

struct node {
    bool is_dir, mapped;
    size_t count, room;
    struct change *at;
};

struct power_disk {
    const struct power_trace *trace;
    size_t count, room;
    struct node *node; /* 0 is the root */
};

static void give_up(const char *what)
{
    perror(what);
    exit(70);
}

static void *grow(void *at, size_t count, size_t *room, size_t size)
{
    void *more = at;

    if (count == *room) {
        *room = *room ? 2 * *room : 8;
        more = gsn_realloc_array(at, *room, size);
        if (!more)
            give_up("memory");
    }
    return more;
}

static size_t add_node(struct power_disk *disk, bool is_dir)
{
    disk->node = grow(disk->node, disk->count, &disk->room, sizeof *disk->node);
    disk->node[disk->count] = (struct node){ .is_dir = is_dir };
    return disk->count++;
}

static void add_change(struct node *node, struct change change)
{
    node->at = grow(node->at, node->count, &node->room, sizeof *node->at);
    node->at[node->count++] = change;
}

/* ---- reading the trace: every step becomes changes of nodes ---- */

/* The last part of the name that a change is about. */
static const char *name_of(const struct power_disk *disk, const struct change *change)
{
    const struct power_step *const step = &disk->trace->at[change->step];
    const bool is_target =
        change->op == POWER_CREATE && (step->op == POWER_RENAME || step->op == POWER_LINK);
    const char *const full = is_target ? step->other : step->name;
    const char *const slash = strrchr(full, '/');

    return slash ? slash + 1 : full;
}

/* What a name in the directory leads to after all changes so far; SIZE_MAX: nothing. */
static size_t look_up(const struct power_disk *disk, size_t dir, const char *name)
{
    const struct node *const node = &disk->node[dir];

    for (size_t i = node->count; i-- > 0;) {
        const struct change *const change = &node->at[i];

        if (change->op != POWER_SYNC_DIR && strcmp(name_of(disk, change), name) == 0)
            return change->op == POWER_CREATE ? change->node : SIZE_MAX;
    }
    return SIZE_MAX;
}

/* The directory of a path; ret_last: its last name. */
static size_t walk(const struct power_disk *disk, const char *path, const char **ret_last)
{
    size_t dir = 0;

    for (const char *slash; (slash = strchr(path, '/')); path = slash + 1) {
        char name[256];

        (void)snprintf(name, sizeof name, "%.*s", (int)(slash - path), path);
        dir = look_up(disk, dir, name);
        if (dir == SIZE_MAX)
            give_up("the trace names a directory that is not there");
    }
    *ret_last = path;
    return dir;
}

static size_t find(const struct power_disk *disk, const char *path)
{
    const char *last;
    const size_t dir = walk(disk, path, &last);

    return *last ? look_up(disk, dir, last) : dir;
}

static void change_name(struct power_disk *disk, enum power_op op, size_t step, const char *path,
                        size_t node)
{
    const char *last;
    const size_t dir = walk(disk, path, &last);

    add_change(&disk->node[dir], (struct change){ op, step, node });
}

/* Which node an inode number stands for now: numbers are used again. */
struct inodes {
    size_t count, room;
    struct {
        uint64_t inode;
        size_t node;
    } * at;
};

static size_t node_of(const struct inodes *inodes, uint64_t inode)
{
    for (size_t i = inodes->count; i-- > 0;) {
        if (inodes->at[i].inode == inode)
            return inodes->at[i].node;
    }
    give_up("the trace writes to a file that nobody made");
    return SIZE_MAX;
}

static void read_step(struct power_disk *disk, struct inodes *inodes, size_t index)
{
    const struct power_step *const step = &disk->trace->at[index];
    size_t node;

    switch (step->op) {
    case POWER_CREATE:
    case POWER_MKDIR:
        node = add_node(disk, step->op == POWER_MKDIR);
        change_name(disk, POWER_CREATE, index, step->name, node);
        inodes->at = grow(inodes->at, inodes->count, &inodes->room, sizeof *inodes->at);
        inodes->at[inodes->count].inode = step->op == POWER_MKDIR ? 0 : step->inode;
        inodes->at[inodes->count++].node = node;
        break;
    case POWER_UNLINK:
        change_name(disk, POWER_UNLINK, index, step->name, 0);
        break;
    case POWER_RENAME:
    case POWER_LINK:
        node = find(disk, step->name);
        if (step->op == POWER_RENAME)
            change_name(disk, POWER_UNLINK, index, step->name, 0);
        change_name(disk, POWER_CREATE, index, step->other, node);
        break;
    case POWER_SYNC_DIR:
        node = find(disk, step->name);
        add_change(&disk->node[node], (struct change){ step->op, index, 0 });
        break;
    case POWER_MARK:
        break;
    default:
        node = node_of(inodes, step->inode);
        disk->node[node].mapped |= step->op == POWER_MAPPED;
        add_change(&disk->node[node], (struct change){ step->op, index, 0 });
    }
}

struct power_disk *power_disk_new(const struct power_trace *trace)
{
    struct power_disk *disk = gsn_alloc_array(1, sizeof *disk);
    struct inodes inodes = { 0 };

    if (!disk)
        give_up("memory");
    disk->trace = trace;
    (void)add_node(disk, true);
    for (size_t i = 0; i < trace->count; i++)
        read_step(disk, &inodes, i);
    gsn_free(inodes.at);
    return disk;
}

void power_disk_free(struct power_disk *disk)
{
    for (size_t i = 0; i < disk->count; i++)
        gsn_free(disk->node[i].at);
    gsn_free(disk->node);
    gsn_free(disk);
}

/* ---- making a disk ---- */

enum fate { FATE_ALL, FATE_NONE, FATE_UP_TO, FATE_EACH };

struct maker {
    const struct power_disk *disk;
    size_t cut;
    uint64_t seed;
    bool peace; /* nothing is lost */
    enum fate names;
    size_t journal; /* FATE_UP_TO of all directories at once; SIZE_MAX: of each by itself */
    char **made;    /* where a node's file is already: a second name is a link */
};

static uint64_t draw(struct maker *maker)
{
    uint64_t z = (maker->seed += 0x9e3779b97f4a7c15u);

    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    return z ^ (z >> 31);
}

static size_t draw_below(struct maker *maker, size_t end)
{
    return (size_t)(draw(maker) % end);
}

/* The last sync that came back, as an index into the changes; those before it are certain. */
static size_t certain(const struct maker *maker, const struct node *node)
{
    for (size_t i = node->count; i-- > 0;) {
        if ((node->at[i].op == POWER_SYNC || node->at[i].op == POWER_SYNC_DIR) &&
            node->at[i].step < maker->cut)
            return i;
    }
    return 0;
}

static size_t happened(const struct maker *maker, const struct node *node)
{
    size_t count = 0;

    while (count < node->count && node->at[count].step <= maker->cut)
        count++;
    return count;
}

/* Which of the changes begin..end-1 reach the disk. */
struct lot {
    enum fate fate;
    size_t up_to;  /* an index */
    unsigned odds; /* of 256 */
};

static struct lot draw_lot(struct maker *maker, size_t begin, size_t end)
{
    static const unsigned odds[] = { 16, 64, 128, 192, 240 };
    struct lot lot = { .fate = maker->peace ? FATE_ALL : (enum fate)draw_below(maker, 4) };

    lot.up_to = begin + draw_below(maker, end - begin + 1);
    lot.odds = odds[draw_below(maker, sizeof odds / sizeof *odds)];
    return lot;
}

static bool reaches(struct maker *maker, const struct lot *lot, size_t index)
{
    switch (lot->fate) {
    case FATE_ALL:
        return true;
    case FATE_NONE:
        return false;
    case FATE_UP_TO:
        return index < lot->up_to;
    default:
        return draw(maker) % 256 < lot->odds;
    }
}

struct image {
    uint8_t *bytes;
    size_t room, size;
};

static void reserve(struct image *image, size_t size)
{
    uint8_t *bytes;

    if (size <= image->room)
        return;
    bytes = gsn_realloc_array(image->bytes, size + size / 2, 1);
    if (!bytes)
        give_up("memory");
    memset(bytes + image->room, 0, size + size / 2 - image->room);
    image->bytes = bytes;
    image->room = size + size / 2;
}

static void cut_bytes(struct image *image, size_t size)
{
    reserve(image, size);
    if (size < image->room)
        memset(image->bytes + size, 0, image->room - size);
}

/* Sectors are those of the file. */
static void write_sectors(struct maker *maker, struct image *image, const struct power_step *step,
                          const struct lot *lot, size_t index)
{
    const size_t end = step->offset + step->size;

    reserve(image, end);
    for (size_t at = step->offset; at < end;) {
        const size_t next =
            at / SECTOR * SECTOR + SECTOR < end ? at / SECTOR * SECTOR + SECTOR : end;

        if (reaches(maker, lot, index))
            memcpy(image->bytes + at, step->data + (at - step->offset), next - at);
        at = next;
    }
}

static void apply(struct maker *maker, struct image *image, const struct change *change,
                  const struct lot *lot, size_t index, size_t *size)
{
    const struct power_step *const step = &maker->disk->trace->at[change->step];

    if (change->op == POWER_WRITE) {
        write_sectors(maker, image, step, lot, index);
        if (step->offset + step->size > *size)
            *size = step->offset + step->size;
    } else if (change->op == POWER_SIZE) {
        if (step->offset < *size && reaches(maker, lot, index))
            cut_bytes(image, step->offset);
        *size = step->offset;
    }
}

/* What of a file is on the disk. */
static void make_image(struct maker *maker, const struct node *node, struct image *image)
{
    static const struct lot all = { .fate = FATE_ALL };
    const size_t begin = certain(maker, node), end = happened(maker, node);
    const struct lot lot = draw_lot(maker, begin, end);
    const size_t moment =
        lot.fate == FATE_EACH ? begin + draw_below(maker, end - begin + 1) : lot.up_to;
    size_t size = 0, chosen = 0;

    for (size_t i = 0; i < end; i++) {
        if (i == begin)
            chosen = size;
        apply(maker, image, &node->at[i], i < begin ? &all : &lot, i, &size);
        if (lot.fate == FATE_ALL || (lot.fate != FATE_NONE && i < moment))
            chosen = size;
    }
    cut_bytes(image, chosen);
    image->size = chosen;
}

/* Zeros, noise or nothing. */
static void make_noise(struct maker *maker, struct image *image)
{
    const size_t how = draw_below(maker, 3);

    image->size = how == 0 ? 0 : 32768;
    reserve(image, image->size);
    for (size_t i = 0; how == 2 && i < image->size; i += 8) {
        const uint64_t word = draw(maker);

        memcpy(image->bytes + i, &word, 8);
    }
}

static void put_file(struct maker *maker, size_t index, const char *path)
{
    const struct node *const node = &maker->disk->node[index];
    struct image image = { 0 };
    int fd;

    if (maker->made[index]) {
        if (link(maker->made[index], path) < 0)
            give_up(path);
        return;
    }
    if (node->mapped && !maker->peace)
        make_noise(maker, &image);
    else
        make_image(maker, node, &image);
    fd = open(path, O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
    if (fd < 0 || (image.size && write(fd, image.bytes, image.size) != (ssize_t)image.size))
        give_up(path);
    for (size_t i = node->count; i-- > 0;) {
        if (node->at[i].op == POWER_MODE && node->at[i].step <= maker->cut) {
            if (fchmod(fd, maker->disk->trace->at[node->at[i].step].mode & 0777) < 0)
                give_up(path);
            break;
        }
    }
    (void)close(fd);
    maker->made[index] = gsn_strdup(path);
    gsn_free(image.bytes);
}

struct name {
    const char *text;
    size_t node;
};

static void change_names(struct name *names, size_t *count, const char *text,
                         const struct change *change)
{
    size_t i = 0;

    while (i < *count && strcmp(names[i].text, text) != 0)
        i++;
    if (change->op == POWER_CREATE) {
        names[i] = (struct name){ text, change->node };
        *count += i == *count;
    } else if (i < *count) {
        names[i] = names[--*count];
    }
}

static void put_dir(struct maker *maker, size_t index, const char *path)
{
    const struct node *const node = &maker->disk->node[index];
    const size_t begin = certain(maker, node), end = happened(maker, node);
    struct name *const names = gsn_alloc_array(end + 1, sizeof *names);
    struct lot lot = draw_lot(maker, begin, end);
    size_t count = 0;

    if (!names)
        give_up("memory");
    lot.fate = maker->peace ? FATE_ALL : maker->names;
    for (size_t i = 0; i < end; i++) {
        const struct change *const change = &node->at[i];
        const bool by_journal = lot.fate == FATE_UP_TO && maker->journal != SIZE_MAX;

        if (change->op == POWER_SYNC_DIR)
            continue;
        if (i < begin || (by_journal ? change->step <= maker->journal : reaches(maker, &lot, i)))
            change_names(names, &count, name_of(maker->disk, change), change);
    }
    for (size_t i = 0; i < count; i++) {
        gsn_auto_mem(char) inner = gsn_format("%s/%s", path, names[i].text);

        if (!inner)
            give_up("memory");
        if (!maker->disk->node[names[i].node].is_dir) {
            put_file(maker, names[i].node, inner);
        } else {
            if (mkdir(inner, 0755) < 0)
                give_up(inner);
            put_dir(maker, names[i].node, inner);
        }
    }
    gsn_free(names);
}

static void make(struct maker *maker, const char *dir)
{
    maker->made = gsn_alloc_array(maker->disk->count, sizeof *maker->made);
    if (!maker->made)
        give_up("memory");
    put_dir(maker, 0, dir);
    for (size_t i = 0; i < maker->disk->count; i++)
        gsn_free(maker->made[i]);
    gsn_free(maker->made);
}

void power_disk_make(const struct power_disk *disk, size_t cut, uint64_t seed, const char *dir)
{
    struct maker maker = { .disk = disk, .cut = cut, .seed = seed };

    maker.names = (enum fate)draw_below(&maker, 4);
    maker.journal =
        maker.names == FATE_UP_TO && draw_below(&maker, 2) ? draw_below(&maker, cut + 1) : SIZE_MAX;
    make(&maker, dir);
}

void power_disk_make_all(const struct power_disk *disk, const char *dir)
{
    struct maker maker = { .disk = disk, .cut = SIZE_MAX, .peace = true };

    make(&maker, dir);
}
