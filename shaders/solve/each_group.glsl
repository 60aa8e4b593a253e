// Loops over groups of layers: EACH_GROUP is defined as the name of one of these, and GROUP as what each group does.
// Unrolled, with the bounds GROUP_START_k as constants, where layers are few.
// A software renderer ends a shader's loops after 65535 rounds in all.  Where loops would need more, a round does several:
// GROUPS_BY_... groups that have one layer (SINGLE) or a few, MOST at most, or AT_ONCE layers of a group.  The compiler
// unrolls loops over so many.
#define SEEN_GROUP(k) GROUP(k, GROUP_START[k], group_seen[k] ? GROUP_START[k + 1] : GROUP_START[k])
#define GROUPS_IN_A_LOOP for (int k = 0; k < GROUPS; k++) { SEEN_GROUP(k) }
#define FOUR_GROUPS(k) SEEN_GROUP(k) SEEN_GROUP(k + 1) SEEN_GROUP(k + 2) SEEN_GROUP(k + 3)
#define GROUPS_BY_4 for (int k = 0; k < GROUPS; k += 4) { FOUR_GROUPS(k) }
#define GROUPS_BY_8 for (int k = 0; k < GROUPS; k += 8) { FOUR_GROUPS(k) FOUR_GROUPS(k + 4) }
#if defined(SINGLE)
#define EACH_OF_GROUP(n) int n = first; if (n < end)
#elif defined(MOST)
#define EACH_OF_GROUP(n) for (int j = 0, n = first; j < MOST; j++, n++) if (n < end)
#elif defined(AT_ONCE)
#define EACH_OF_GROUP(n) for (int m = first; m < end; m += AT_ONCE) for (int j = 0, n = m; j < AT_ONCE; j++, n++) if (n < end)
#else
#define EACH_OF_GROUP(n) for (int n = first; n < end; n++)
#endif
#define GROUPS_1 GROUP(0, GROUP_START_0, GROUP_START_1)
#define GROUPS_2 GROUPS_1 GROUP(1, GROUP_START_1, GROUP_START_2)
#define GROUPS_3 GROUPS_2 GROUP(2, GROUP_START_2, GROUP_START_3)
#define GROUPS_4 GROUPS_3 GROUP(3, GROUP_START_3, GROUP_START_4)
#define GROUPS_5 GROUPS_4 GROUP(4, GROUP_START_4, GROUP_START_5)
#define GROUPS_6 GROUPS_5 GROUP(5, GROUP_START_5, GROUP_START_6)
#define GROUPS_7 GROUPS_6 GROUP(6, GROUP_START_6, GROUP_START_7)
#define GROUPS_8 GROUPS_7 GROUP(7, GROUP_START_7, GROUP_START_8)
#define GROUPS_9 GROUPS_8 GROUP(8, GROUP_START_8, GROUP_START_9)
#define GROUPS_10 GROUPS_9 GROUP(9, GROUP_START_9, GROUP_START_10)
#define GROUPS_11 GROUPS_10 GROUP(10, GROUP_START_10, GROUP_START_11)
#define GROUPS_12 GROUPS_11 GROUP(11, GROUP_START_11, GROUP_START_12)
#define GROUPS_13 GROUPS_12 GROUP(12, GROUP_START_12, GROUP_START_13)
#define GROUPS_14 GROUPS_13 GROUP(13, GROUP_START_13, GROUP_START_14)
#define GROUPS_15 GROUPS_14 GROUP(14, GROUP_START_14, GROUP_START_15)
#define GROUPS_16 GROUPS_15 GROUP(15, GROUP_START_15, GROUP_START_16)
