#include "client/completion.h"

#include <stdio.h>
#include <string.h>

// What is written for each option: `context` is the verb's name, "" for options of every verb.
typedef void option_writer(const char *verb, const char *name, char letter, const char *choices,
                           bool takes_value, const char *help);

static void each_setting(const char *verb, const struct rn_settings *settings,
                         option_writer *write) {
    for (size_t i = 0; i < settings->count; i++) {
        const struct rn_setting *row = &settings->rows[i];
        char choices[RN_CHOICES_MAX];
        size_t length = rn_choices_join(row->choices, choices);
        bool first =
            row->flag && rn_settings_flagged(settings, 0, row->flag, strlen(row->flag)) == row;
        if (row->key) length = 0; // NAME=..., which shells split in their own ways
        if (first)
            write(verb, row->flag, 0, length ? choices : NULL, !rn_setting_is_flag(row),
                  row->meaning);
    }
}

static void each_option(const char *verb, const struct rn_option *table, option_writer *write) {
    char room[RN_CHOICES_MAX];
    for (const struct rn_option *option = table; option->name; option++)
        if (option->settings)
            each_setting(verb, option->settings, write);
        else
            write(verb, option->name, option->letter, rn_option_choices(option, room),
                  option->kind != RN_OPTION_FLAG, option->help);
}

// Text for a shell's single quotes, in one line.
static void print_quoted(const char *text) {
    putchar('\'');
    for (; *text; text++)
        if (*text == '\'')
            fputs("'\\''", stdout);
        else
            putchar(*text == '\n' ? ' ' : *text);
    putchar('\'');
}

// The words that a verb's first argument is one of, with spaces between; false where it is none.
static bool first_words(const struct rn_verb *verb, char ret_words[64]) {
    const char *text = verb->arguments + (verb->arguments[0] == '[');
    size_t length = strspn(text, "abcdefghijklmnopqrstuvwxyz|");
    bool several = memchr(text, '|', length) != NULL;
    if (!several || length >= 64) return false;
    for (size_t i = 0; i <= length; i++)
        ret_words[i] = i == length ? '\0' : text[i] == '|' ? ' ' : text[i];
    return true;
}

// ---- bash, and zsh by way of it ---------------------------------------------------------------

static void bash_name(const char *verb, const char *name, char letter, const char *choices,
                      bool takes_value, const char *help) {
    printf(" --%s", name);
    if (letter) printf(" -%c", letter);
}

static void bash_choices(const char *verb, const char *name, char letter, const char *choices,
                         bool takes_value, const char *help) {
    if (!choices) return;
    printf("        %s:--%s) words='", *verb ? verb : "*", name);
    for (; *choices; choices++)
        putchar(*choices == '|' ? ' ' : *choices);
    printf("' ;;\n");
}

static void print_bash(const struct rn_verb *const *groups, size_t count,
                       const struct rn_option *globals) {
    char words[64];
    puts("# bash completion of ripnerf\n_ripnerf() {\n"
         "    local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD - 1]}\n"
         "    local verb=${COMP_WORDS[1]} words=\n"
         "    if [ \"$COMP_CWORD\" -eq 1 ]; then\n        words='help");
    for (size_t i = 0; i < count; i++)
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++)
            printf("            %s\n", verb->name);
    puts("        '\n        mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$word\")\n"
         "        return\n    fi\n    case $verb:$before in");
    for (size_t i = 0; i < count; i++)
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++)
            each_option(verb->name, verb->table, bash_choices);
    each_option("", globals, bash_choices);
    puts("    esac\n    case $COMP_CWORD:$verb:$word in\n        *:-*) ;;");
    for (size_t i = 0; i < count; i++)
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++)
            if (first_words(verb, words))
                printf("        2:%s:*) words='%s' ;;\n", verb->name, words);
    puts("    esac\n    if [ -z \"$words\" ] && [ \"${word:0:1}\" = - ]; then\n"
         "        case $verb in");
    for (size_t i = 0; i < count; i++)
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++) {
            printf("        %s) words='", verb->name);
            each_option(verb->name, verb->table, bash_name);
            puts("' ;;");
        }
    fputs("        esac\n        words+='", stdout);
    each_option("", globals, bash_name);
    puts("'\n    fi\n"
         "    if [ -n \"$words\" ]; then\n"
         "        mapfile -t COMPREPLY < <(compgen -W \"$words\" -- \"$word\")\n"
         "    else\n        mapfile -t COMPREPLY < <(compgen -f -- \"$word\")\n    fi\n}\n"
         "complete -o filenames -F _ripnerf ripnerf");
}

// ---- zsh --------------------------------------------------------------------------------------

static void zsh_word(const char *dashes, const char *name, const char *help, const char *choices,
                     bool takes_value) {
    printf("            '%s%s[%s]", dashes, name, help);
    if (choices) {
        printf(":value:(");
        for (; *choices; choices++)
            putchar(*choices == '|' ? ' ' : *choices);
        putchar(')');
    } else if (takes_value) {
        printf(":value:_files");
    }
    puts("' \\");
}

static void zsh_option(const char *verb, const char *name, char letter, const char *choices,
                       bool takes_value, const char *help) {
    char clean[400];
    size_t length = 0;
    for (; *help && length + 2 < sizeof clean; help++) // brackets and colons are its own
        clean[length++] = strchr("[]:\n'", *help) ? ' ' : *help;
    clean[length] = '\0';
    zsh_word("--", name, clean, choices, takes_value);
    if (letter) zsh_word("-", (char[]){letter, '\0'}, clean, choices, takes_value);
}

static void print_zsh(const struct rn_verb *const *groups, size_t count,
                      const struct rn_option *globals) {
    char words[64];
    puts("#compdef ripnerf\n_ripnerf() {\n    local -a verbs\n    verbs=(");
    for (size_t i = 0; i < count; i++)
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++) {
            char text[300];
            snprintf(text, sizeof text, "%s:%s", verb->name, verb->summary);
            fputs("        ", stdout);
            print_quoted(text);
            putchar('\n');
        }
    puts("    )\n    if (( CURRENT == 2 )); then\n        _describe verb verbs\n        return\n"
         "    fi\n    case ${words[2]} in");
    for (size_t i = 0; i < count; i++)
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++) {
            printf("    %s)\n        _arguments \\\n", verb->name);
            each_option(verb->name, verb->table, zsh_option);
            each_option("", globals, zsh_option);
            if (first_words(verb, words)) printf("            '2:word:(%s)' \\\n", words);
            puts("            '*:file:_files' ;;");
        }
    puts("    esac\n}\n_ripnerf \"$@\"");
}

// ---- fish -------------------------------------------------------------------------------------

static void fish_option(const char *verb, const char *name, char letter, const char *choices,
                        bool takes_value, const char *help) {
    printf("complete -c ripnerf");
    if (*verb) printf(" -n '__fish_seen_subcommand_from %s'", verb);
    printf(" -l %s", name);
    if (letter) printf(" -s %c", letter);
    if (takes_value) printf(choices ? " -x" : " -r");
    if (choices) {
        printf(" -a '");
        for (; *choices; choices++)
            putchar(*choices == '|' ? ' ' : *choices);
        putchar('\'');
    }
    printf(" -d ");
    print_quoted(help);
    putchar('\n');
}

static void print_fish(const struct rn_verb *const *groups, size_t count,
                       const struct rn_option *globals) {
    char words[64];
    for (size_t i = 0; i < count; i++)
        for (const struct rn_verb *verb = groups[i]; verb->name; verb++) {
            printf("complete -c ripnerf -n __fish_use_subcommand -f -a %s -d ", verb->name);
            print_quoted(verb->summary);
            putchar('\n');
            if (first_words(verb, words))
                printf("complete -c ripnerf -n '__fish_seen_subcommand_from %s' -f -a '%s'\n",
                       verb->name, words);
            each_option(verb->name, verb->table, fish_option);
        }
    each_option("", globals, fish_option);
}

bool rn_completion_print(const char *shell, const struct rn_verb *const *groups, size_t count,
                         const struct rn_option *globals) {
    if (strcmp(shell, "bash") == 0)
        print_bash(groups, count, globals);
    else if (strcmp(shell, "zsh") == 0)
        print_zsh(groups, count, globals);
    else if (strcmp(shell, "fish") == 0)
        print_fish(groups, count, globals);
    else
        return false;
    return true;
}
